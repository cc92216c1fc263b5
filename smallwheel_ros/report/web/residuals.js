/* SPDX-License-Identifier: Apache-2.0 */
// What models leave of each channel: measured over predicted, and residuals over one setting.
'use strict';

const WIDTH = 0.14; // of the kernel, as a share of the range
const STEPS = 41;

/**
 * A smooth through points and its 95 % band. x, y: numbers; run: of each point; levels: the few
 * values of x, where it has only a few: then the mean at each.
 * Local linear regression with a Gaussian kernel (Cleveland 1979); rows of a run belong together, so
 * the band is made of the runs' sums (Liang and Zeger 1986), times runs / (runs - 1).
 */
function smooth(x, y, run, levels) {
  const low = Math.min(...x), range = Math.max(...x) - low;
  if (x.length < 3 || !(range > 0)) return null;
  const at = levels || Array.from({length: STEPS}, (_, j) => low + range * j / (STEPS - 1));
  const found = at.map(place => pull(x, y, place, range, levels));
  const middle = found.map(one => one.value);
  const left = y.map((value, i) => value - between(at, middle, x[i]));
  const curve = {x: at, y: middle, low: [], high: []};
  found.forEach((one, j) => {
    const sums = new Map(), near = new Set();
    one.weight.forEach((weight, i) => {
      sums.set(run[i], (sums.get(run[i]) || 0) + weight * left[i]);
      if (one.kernel[i] > 0.3) near.add(run[i]);
    });
    const some = [...sums.values()].filter(value => value !== 0).length;
    const total = [...sums.values()].reduce((sum, value) => sum + value * value, 0);
    const half = 1.96 * Math.sqrt(total * some / (some - 1));
    const told = near.size >= 3 && Number.isFinite(half);
    curve.low.push(told ? middle[j] - half : null);
    curve.high.push(told ? middle[j] + half : null);
  });
  return curve;
}

/** The curve's value at one place, and the weight that each point has in it. */
function pull(x, y, place, range, levels) {
  const offset = x.map(value => (levels ? 0 : (value - place) / (WIDTH * range)));
  const nearest = value => levels.reduce((a, b) => (Math.abs(b - value) < Math.abs(a - value) ? b : a));
  const kernel = levels ? x.map(value => (nearest(value) === place ? 1 : 0)) : offset.map(d => Math.exp(-d * d / 2));
  const sum = f => kernel.reduce((total, w, i) => total + w * f(offset[i]), 0);
  const s0 = sum(() => 1), s1 = sum(d => d), s2 = sum(d => d * d), area = s0 * s2 - s1 * s1;
  const sloped = area > 1e-9 * s0 * s0;
  const weight = kernel.map((w, i) => (sloped ? w * (s2 - offset[i] * s1) / area : w / s0));
  const value = weight.reduce((total, w, i) => total + w * y[i], 0);
  return {value: Number.isFinite(value) ? value : null, weight, kernel};
}

function between(at, values, x) {
  let j = at.findIndex(place => place >= x);
  if (j <= 0) j = j < 0 ? at.length - 1 : 1;
  if (j >= at.length) return values[at.length - 1];
  const share = Math.max(0, Math.min(1, (x - at[j - 1]) / (at[j] - at[j - 1])));
  return values[j - 1] + share * (values[j] - values[j - 1]);
}

/** A row in words: run and line, its settings, what was measured and predicted. */
function rowLines(table, row, channel, measured, predicted) {
  const where = `run ${table.runs[table.run[row]]}, ${table.place} ${table.line[row]}`;
  const settings = Object.values(table.settings)
    .filter(one => known(one.values[row]))
    .map(one => `${one.words} ${Number(one.values[row].toPrecision(3))}${one.unit ? ' ' + one.unit : ''}`);
  const texts = Object.entries(table.texts).map(([name, values]) => `${name} ${values[row]}`);
  const {unit} = table.channels[channel];
  return [where, [...settings, ...texts].join(', '),
    `${table.channels[channel].words}: measured ${number(measured)} ${unit}, predicted ${number(predicted)} ${unit}`];
}

/**
 * The two plots of each channel. table: rows, settings, channels. models: [{name, colour, residual}].
 * over: the setting. gone: a run that is grey, or null. click(run): of a point.
 */
class Residuals {
  constructor(box) {
    this.box = box;
    this.plots = [];
  }

  show(table, models, over, gone, click) {
    this.plots.forEach(plot => plot.end());
    this.plots = [];
    this.box.replaceChildren(legend(models.map(model => [model.colour, model.name])));
    const grid = this.box.appendChild(el('div', {class: 'plots'}));
    const setting = table.settings[over];
    for (const [name, channel] of Object.entries(table.channels)) {
      const shown = models.filter(model => model.residual[name]);
      if (!shown.length) continue;
      const part = (x, y, model) => ({
        kind: 'points', x, y, colour: model.colour, alpha: 0.55,
        faded: i => table.run[channel.rows[i]] === gone,
        lines: i => rowLines(table, channel.rows[i], name, channel.measured[i],
          channel.measured[i] - model.residual[name][i]),
        click: click && (i => click(table.run[channel.rows[i]])),
      });
      const band = 2 * (channel.floor || 0);
      const predicted = model => channel.measured.map((value, i) =>
        (known(model.residual[name][i]) ? value - model.residual[name][i] : null));
      const along = span([channel.measured]);
      this.add(grid, {
        title: `${channel.words}: measured against predicted`,
        label: `${channel.words}: measured against predicted, ${shown.map(model => model.name).join(' and ')}`,
        x: {label: `predicted ${channel.label}`, range: span([...shown.map(predicted), channel.measured])},
        y: {label: `measured ${channel.label}`, range: along},
        layers: [{kind: 'band', slope: 1, low: -band, high: band},
          ...shown.map(model => part(predicted(model), channel.measured, model))],
      });
      const at = channel.rows.map(row => setting.values[row]);
      const curves = shown.map(model => {
        const used = at.flatMap((x, i) => (known(x) && known(model.residual[name][i])
          && table.run[channel.rows[i]] !== gone ? [i] : []));
        const curve = smooth(used.map(i => at[i]), used.map(i => model.residual[name][i]),
          used.map(i => table.run[channel.rows[i]]), setting.levels);
        return curve && {kind: 'line', ...curve, colour: model.colour, dots: Boolean(setting.levels)};
      }).filter(Boolean);
      this.add(grid, {
        title: `${channel.words}: what is left over ${setting.words}`,
        label: `${channel.words}: residuals over ${setting.words}`,
        x: {label: setting.label, range: span([at])},
        y: {label: `measured - predicted [${channel.unit}]`, range: span(shown.map(m => m.residual[name]), 0.08)},
        layers: [{kind: 'band', low: -band, high: band},
          ...shown.map(model => part(at, model.residual[name], model)), ...curves],
      });
    }
  }

  add(grid, spec) {
    this.plots.push(new Plot(grid.appendChild(el('div', {class: 'plot'})), spec));
  }
}

// Models of a comparison: one beside the best.
for (const box of document.querySelectorAll('[data-models]')) {
  const given = DATA[box.dataset.models], view = new Residuals(el('div', {}));
  const chosen = box.querySelector('select[name=model]'), over = box.querySelector('select[name=over]');
  const draw = () => {
    const models = given.models.filter((model, i) => i === given.best || i === Number(chosen.value));
    view.show(given.table, models.map(model => ({
      ...model, colour: model.name === given.models[chosen.value].name ? '--with' : '--base',
    })), over.value, null, null);
  };
  chosen.closest('p').after(view.box);
  box.addEventListener('change', draw);
  draw();
}
