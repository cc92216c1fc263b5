/* SPDX-License-Identifier: Apache-2.0 */
// A drive: the way as a map, wheels and soil over time; where one is pointed at, all others show it.
'use strict';

// Colours from light to dark that the colour-blind tell apart: cividis; and blue to orange around 0.
const DEEP = [[255, 234, 70], [188, 175, 111], [124, 123, 120], [66, 78, 108], [0, 34, 78]];
const SIGNED = [[179, 88, 6], [241, 163, 64], [225, 225, 225], [103, 169, 207], [5, 72, 130]];

function shade(stops, share) {
  const at = Math.max(0, Math.min(1, share)) * (stops.length - 1), i = Math.min(Math.floor(at), stops.length - 2);
  return `rgb(${stops[i].map((low, c) => Math.round(low + (at - i) * (stops[i + 1][c] - low))).join(',')})`;
}

class Drive {
  constructor(box) {
    this.data = DATA[box.dataset.drive];
    this.panels = [];
    this.view = box.querySelector('[data-part=map]');
    this.time = span([this.data.wheels.flatMap(wheel => wheel.time)], 0.01);
    this.changes = this.at('soil_change');
    this.alarms = this.data.events.filter(event => event.kind !== 'soil_change').map(event => event.time);
    if (this.data.way) {
      this.select = box.querySelector('select[name=colour]');
      this.select.addEventListener('change', () => this.map());
      this.map();
    }
    const wheels = box.querySelector('[data-part=wheels]'), soil = box.querySelector('[data-part=soil]');
    const {data} = this;
    wheels.append(legend([...data.wheels.map((wheel, i) => [this.shade(i), wheel.name]),
      ['--change', 'the soil changed', [2]], ['--alarm', 'alarm', [2]]]));
    const many = wheels.appendChild(el('div', {class: 'plots'}));
    const deep = data.wheels.flatMap(wheel => [wheel.measured, wheel.sinkage.y]);
    const range = [0, Math.max(span(deep, 0.15, 0.995)[1], 1e-3)];
    data.wheels.forEach((wheel, i) => this.over(many, `${wheel.name}: sinkage`, 'sinkage [mm]', range, [
      {kind: 'points', x: wheel.time, y: wheel.measured, colour: '--base', size: 1.6, name: 'measured'},
      {kind: 'points', x: wheel.time, y: wheel.unused, colour: '--alarm', mark: 'cross', size: 2.5,
        name: 'measured, not used for the soil'},
      {kind: 'line', x: wheel.time, ...wheel.sinkage, colour: this.shade(i), name: 'predicted'},
    ], {down: true, height: 190}));
    const pulls = data.wheels.map(wheel => wheel.pull.y), room = span(pulls, 0.35, 0.99);
    if (pulls.flat().some(known)) {
      data.wheels.forEach((wheel, i) => this.over(many, `${wheel.name}: drawbar pull`, 'drawbar pull [N]', room, [
        {kind: 'line', x: wheel.time, ...wheel.pull, colour: this.shade(i), name: 'drawbar pull'},
      ], {height: 190}));
    }
    const all = wheels.appendChild(el('div', {}));
    this.each(all, 'slip: positive when driving, negative when braking', 'slip', wheel => ({y: wheel.slip}));
    this.each(all, 'cost of the ground', 'cost, 0 to 100', wheel => ({y: wheel.cost}), [-3, 103]);
    const four = soil.appendChild(el('div', {class: 'plots'}));
    for (const part of data.soil.parts) {
      const middle = span([part.y], 0.3, 0.99), known = part.y.filter(value => value > 0);
      const y = part.log ? [Math.min(...known) / 3, Math.max(...known) * 3] : span([part.low, part.high], 0.05, 0.95);
      this.over(four, part.label, part.label, part.log && known.length ? y : part.log ? middle : y, [
        {kind: 'line', x: data.soil.time, y: part.y, low: part.low, high: part.high, colour: '--with', name: part.label},
      ], {log: part.log && known.length > 0, height: 200});
    }
  }

  shade(i) { return `--w${i % 8}`; }

  at(kind) { return this.data.events.filter(event => event.kind === kind).map(event => event.time); }

  /** One plot over time of the same quantity of all wheels; none where it is never known. */
  each(box, title, label, of, range) {
    const layers = this.data.wheels.map((wheel, i) =>
      ({kind: 'line', x: wheel.time, ...of(wheel), colour: this.shade(i), name: wheel.name}));
    const values = layers.map(layer => layer.y);
    if (!values.flat().some(known)) return;
    this.over(box, title, label, range || span(values, 0.25, 0.99), layers, {wide: true});
  }

  over(box, title, label, range, layers, {down, log, wide, height = 220} = {}) {
    const unit = (label.match(/\[(.*)\]/) || ['', ''])[1];
    for (const layer of layers) {
      layer.lines = i => [`${number(layer.x[i], 4)} s`, `${layer.name}: ${number(layer.y[i])} ${unit}`,
        ...this.near(layer.x[i])];
    }
    this.panels.push(new Plot(box.appendChild(el('div', {class: 'plot'})), {
      title, label: `${title} over time`, height, wide,
      x: {label: 'time [s]', range: this.time}, y: {label, range, down, log},
      layers: [...layers, {kind: 'events', at: this.changes, colour: '--change'},
        {kind: 'events', at: this.alarms, colour: '--alarm'}],
      moved: (time, from) => this.moved(time, from),
    }));
  }

  /** What happened near a time, in words. */
  near(time) {
    const close = 0.01 * (this.time[1] - this.time[0]);
    return this.data.events.filter(event => Math.abs(event.time - time) < close).map(event => event.text);
  }

  /** The way, coloured by what was chosen. */
  map() {
    const {way} = this.data, kind = this.select.value, signed = kind === 'margin';
    const values = way[kind].filter(known), sizes = values.map(Math.abs).sort((a, b) => a - b);
    const most = kind === 'cost' ? 100 : Math.max(sizes[Math.floor(0.99 * (sizes.length - 1))] || 1, 1e-3);
    const [stops, low] = signed ? [SIGNED, -most] : [DEEP, 0];
    const unit = {sinkage: ' mm', margin: ' % of load', cost: ''}[kind];
    if (this.panel) { this.panel.end(); this.panels = this.panels.filter(one => one !== this.panel); }
    this.view.replaceChildren();
    const ramp = stops.map(stop => `rgb(${stop.join(',')})`).join(',');
    const box = this.view.appendChild(el('div', {class: 'plot'}));
    this.view.append(el('div', {class: 'ramp'}, number(low) + unit,
      el('i', {style: `background: linear-gradient(to right, ${ramp})`}), number(most) + unit));
    const events = this.data.events.map(event => ({...event, i: this.place(event.time)}))
      .filter(event => event.i >= 0);
    const tall = (Math.max(...way.y.filter(known)) - Math.min(...way.y.filter(known)))
      / Math.max(Math.max(...way.x.filter(known)) - Math.min(...way.x.filter(known)), 1e-9);
    this.panel = new Plot(box, {
      label: `the path, coloured by ${kind}`, wide: true, equal: true,
      height: Math.round(Math.max(220, Math.min(520, 120 + tall * Math.min(box.clientWidth, 1000)))),
      x: {label: 'x [m]', range: span([way.x])}, y: {label: 'y [m]', range: span([way.y])},
      layers: [
        {kind: 'way', x: way.x, y: way.y, value: way[kind], ramp: value => shade(stops, (value - low) / (most - low)),
          time: way.time,
          lines: i => [`${number(way.time[i], 4)} s`, `${kind}: ${number(way[kind][i])}${unit}`, ...this.near(way.time[i])]},
        {kind: 'points', x: events.map(event => way.x[event.i]), y: events.map(event => way.y[event.i]),
          time: events.map(event => event.time), colour: '--ink', alpha: 1, size: 4.5,
          lines: i => [`${number(events[i].time, 4)} s, ${number(events[i].travel)} m`, events[i].text]},
      ],
      moved: (time, from) => this.moved(time, from),
    });
    this.panels.push(this.panel);
  }

  /** The step of the way at a time, -1 where there is none. */
  place(time) {
    const {way} = this.data;
    if (!way || !known(time)) return -1;
    let best = -1;
    way.time.forEach((at, i) => {
      if (known(at) && (best < 0 || Math.abs(at - time) < Math.abs(way.time[best] - time))) best = i;
    });
    return best;
  }

  /** One plot tells where it is pointed at: the others show the same time. */
  moved(time, from) {
    for (const panel of this.panels) {
      if (panel === from) continue;
      if (panel === this.panel) {
        const i = this.place(time);
        panel.mark(i < 0 ? null : this.data.way.x[i], i < 0 ? null : this.data.way.y[i]);
      } else {
        panel.follow(time);
      }
    }
  }
}

for (const box of document.querySelectorAll('[data-drive]')) new Drive(box);
