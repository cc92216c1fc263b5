/* SPDX-License-Identifier: Apache-2.0 */
// Effects set and unset: every view that was fitted beforehand is here; others a server is asked for.
'use strict';

class Effects {
  constructor(box) {
    this.box = box;
    this.data = DATA[box.dataset.effects];
    this.form = box.querySelector('form');
    this.parts = Object.fromEntries([...box.querySelectorAll('[data-part]')].map(one => [one.dataset.part, one]));
    this.residuals = new Residuals(this.parts.residuals);
    this.gone = null;
    this.asked = 0;
    this.order = this.set();
    this.form.addEventListener('change', event => this.changed(event));
    this.form.addEventListener('submit', event => !event.submitter?.dataset.save && event.preventDefault());
    this.show(false);
  }

  /** Indices of the effects that are set. */
  set() {
    return [...this.form.querySelectorAll('input[name=effects]:checked')].map(one => Number(one.dataset.index));
  }

  key(indices) { return [...indices].sort((a, b) => a - b).join(','); }

  changed(event) {
    const now = this.set();
    this.order = [...this.order.filter(i => now.includes(i)), ...now.filter(i => !this.order.includes(i))];
    if (event.target.name === 'effects') this.gone = null;
    this.show(true);
  }

  query() { return new URLSearchParams(new FormData(this.form)); }

  async show(told) {
    const key = this.key(this.set()), turn = ++this.asked;
    if (told) {
      try { history.replaceState(null, '', '?' + this.query()); } catch { /* a file in a frame */ }
    }
    let view = this.data.views[key];
    if (!view && this.data.served) view = await this.ask(key);
    if (turn !== this.asked) return; // something else was clicked meanwhile
    this.box.querySelectorAll('.means').forEach(card => {
      card.hidden = !this.order.includes(Number(card.dataset.index));
    });
    if (!view || view.problem) this.absent(view?.problem);
    else this.draw(view, told);
  }

  /** A view from the server, and how far its fits are meanwhile. */
  async ask(key) {
    const bar = el('progress', {max: 1, 'aria-label': 'fitting'});
    this.parts.progress.replaceChildren(bar);
    this.parts.view.classList.add('busy');
    const timer = setInterval(async () => {
      try {
        const {done, needed} = await (await fetch('progress')).json();
        if (needed) bar.value = done / needed;
      } catch { /* the answer itself will say */ }
    }, 400);
    try {
      const answer = await fetch('view?' + this.query());
      const view = answer.ok ? await answer.json() : {problem: await answer.text()};
      if (answer.ok && !view.problem) this.data.views[key] = view;
      return view;
    } catch {
      return {problem: 'The server has ended. Start smallwheel explore again.'};
    } finally {
      clearInterval(timer);
      this.parts.progress.replaceChildren();
      this.parts.view.classList.remove('busy');
    }
  }

  absent(problem) {
    const names = this.order.map(i => this.data.effects[i]).join(', ');
    this.callout({
      kind: 'warning', headline: problem ? 'This cannot be shown' : `Not fitted beforehand: ${names}`,
      items: [problem || `A file has the models that were fitted when it was made. Any other: ${this.data.command}`],
    });
    this.residuals.show(this.data.table, [], this.form.over.value, null, null);
    ['stairs', 'errors', 'parameters', 'point'].forEach(name => this.parts[name].replaceChildren());
  }

  callout({headline, items, kind}) {
    const made = el('div', {class: 'callout ' + kind}, el('p', {class: 'headline'}, headline),
      ...items.map(item => el('p', {}, ...prose(item))));
    this.parts.headline.replaceChildren(made);
  }

  draw(view, told) {
    this.callout(view);
    if (told) say([view.headline, ...view.items].join(' '));
    const base = this.data.views[this.data.base], parts = this.parts;
    this.stairs();
    const {headers, captions} = this.data;
    parts.errors.replaceChildren(table(headers[view === base ? 'base' : 'with'], view.errors, captions.errors,
      [1, 2, 3, 4, 5, 6, 7]));
    const models = [{name: 'base model', colour: '--base', residual: base.residual}];
    if (view !== base) models.push({name: view.name, colour: '--with', residual: view.residual});
    this.residuals.show(this.data.table, models, this.form.over.value, this.gone, run => this.greyed(run, view));
    const {rows, strong} = view.parameters;
    parts.parameters.replaceChildren(table(headers.parameters, rows, captions.parameters, [2, 3], strong),
      el('ul', {}, ...view.soils.map(text => el('li', {}, text))));
    if (view.notes.length) {
      parts.parameters.append(el('details', {}, el('summary', {}, 'Notes on the fit'),
        el('ul', {}, ...view.notes.map(text => el('li', {}, ...prose(text))))));
    }
    for (const [index, formula] of Object.entries(view.formulas)) {
      this.box.querySelector(`.means[data-index="${index}"] .formula code`).textContent = formula;
    }
    if (this.gone === null) parts.point.replaceChildren();
  }

  /** The held-out error of the base and after each effect, in the order in which they were set. */
  stairs() {
    const base = this.data.base === '' ? [] : this.data.base.split(',').map(Number);
    const added = this.order.filter(i => !base.includes(i)), removed = base.filter(i => !this.order.includes(i));
    const steps = [{name: 'base model', key: this.data.base}];
    const now = new Set(base);
    for (const i of removed) { now.delete(i); steps.push({name: '- ' + this.data.effects[i], key: this.key(now)}); }
    for (const i of added) { now.add(i); steps.push({name: '+ ' + this.data.effects[i], key: this.key(now)}); }
    this.parts.stairs.replaceChildren(...Object.entries(this.data.table.channels).map(([name, channel]) => el(
      'div', {}, el('p', {class: 'title'}, `${channel.words}: ${this.data.error} [${channel.unit}]`),
      stairs(steps.map(step => ({name: step.name, ...this.data.views[step.key]?.rmse[name]})), channel.floor))));
  }

  /** A run turns grey; what a fit without it says is asked of the server. */
  async greyed(run, view) {
    this.gone = this.gone === run ? null : run;
    const turn = this.asked;
    this.draw(view, false);
    if (this.gone === null) { say('all runs again'); return; }
    const name = this.data.table.runs[run], box = this.parts.point;
    const lines = found => {
      box.replaceChildren(el('div', {class: 'callout result'}, el('p', {class: 'headline'}, `Run ${name} is grey`),
        ...found.map(text => el('p', {}, ...prose(text))), el('p', {}, 'Click on one of its points again to have it back.')));
      say(found.join(' '));
    };
    if (!this.data.served) {
      lines([`What a fit without it gives is not in this file: ${this.data.command}`]);
      return;
    }
    lines(['Fitting without it.']);
    const query = this.query();
    query.set('run', name);
    let found;
    try {
      const answer = await fetch('without?' + query);
      found = answer.ok ? (await answer.json()).lines : [await answer.text()];
    } catch {
      found = ['The server has ended. Start smallwheel explore again.'];
    }
    if (turn === this.asked && this.gone === run) lines(found);
  }
}

/** Bars of errors with their standard errors, as a drawing; a step that was not fitted has none. */
function stairs(steps, floor) {
  const ns = 'http://www.w3.org/2000/svg', height = 150, step = 92, right = floor ? 84 : 10;
  const draw = (tag, attributes, text) => {
    const made = document.createElementNS(ns, tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text) made.textContent = text;
    return made;
  };
  const top = 1.18 * Math.max(...steps.map(one => (one.value || 0) + (one.std || 0)), floor || 0, 1e-12);
  const y = value => height * (1 - value / top) + 6, wide = step * steps.length + right;
  const box = draw('svg', {viewBox: `0 0 ${wide} ${height + 46}`, width: wide, height: height + 46, role: 'img',
    'aria-label': steps.map(one => `${one.name} ${one.text || 'not fitted'}`).join(', ')
      + (floor ? `, expected of a true model ${number(floor)}` : '')});
  steps.forEach((one, i) => {
    const x = step * i + 8, middle = x + 34;
    if (known(one.value)) {
      box.append(draw('rect', {x, y: y(one.value), width: 68, height: height + 6 - y(one.value),
        fill: `var(--${i ? 'with' : 'base'})`}));
      if (known(one.std)) {
        box.append(draw('path', {d: `M${middle} ${y(one.value - one.std)}V${y(one.value + one.std)}`,
          stroke: 'var(--ink)', 'stroke-width': 1.5}));
      }
      box.append(draw('text', {x: middle, y: y(one.value + (one.std || 0)) - 5, 'text-anchor': 'middle'}, one.text));
    } else {
      box.append(draw('text', {x: middle, y: height, 'text-anchor': 'middle'}, 'not fitted'));
    }
    wrapped(one.name).forEach((line, j) => box.append(
      draw('text', {x: middle, y: height + 21 + 13 * j, 'text-anchor': 'middle'}, line)));
  });
  if (floor) {
    box.append(draw('path', {d: `M0 ${y(floor)}H${wide}`, stroke: 'var(--ink)', 'stroke-dasharray': '5 4', fill: 'none'}));
    box.append(draw('text', {x: wide, y: y(floor) - 4, 'text-anchor': 'end'}, `true model ${number(floor)}`));
  }
  return box;
}

/** A name in at most two lines of some fourteen letters. */
function wrapped(text) {
  const lines = [''];
  for (const word of text.split(' ')) {
    if (lines.at(-1) && (lines.at(-1) + ' ' + word).length > 14) lines.push(word);
    else lines[lines.length - 1] += (lines.at(-1) ? ' ' : '') + word;
  }
  const short = line => (line.length > 15 ? line.slice(0, 14) + '…' : line);
  return lines.length > 2 ? [short(lines[0]), short(lines.slice(1).join(' '))] : lines.map(short);
}

for (const box of document.querySelectorAll('[data-effects]')) new Effects(box);
