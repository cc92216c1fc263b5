/* SPDX-License-Identifier: Apache-2.0 */
// Models of which a reader chooses: shows what was written of the choice, and sets the points of its plots.
'use strict';

const SVG = 'http://www.w3.org/2000/svg';
const DATA = JSON.parse(document.getElementById('data').textContent);
const known = value => value !== null && value !== undefined;
const shown = value => (known(value) ? Number(value.toPrecision(3)) : '-');

function put(parent, tag, attributes, text) {
  const made = parent.appendChild(document.createElementNS(SVG, tag));
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text) put(made, 'title', {}).textContent = text;
  return made;
}

for (const box of document.querySelectorAll('[data-models]')) {
  const data = DATA[box.dataset.models], form = box.querySelector('form');
  const marked = {}, settings = Object.values(data.settings);
  const about = row => `${data.rows[row]}: ` + settings.filter(one => known(one.values[row]))
    .map(one => `${one.words} ${shown(one.values[row])} ${one.unit}`.trim()).join(', ');

  function points(frame, key, colour, group) {
    const {channel: name, over} = frame.dataset, left = data.left[key]?.[name];
    if (!left) return;
    const channel = data.channels[name], {step} = channel;
    const [ax, bx, ay, by] = frame.dataset.scale.split(' ').map(Number);
    const [, , width, height] = frame.querySelector('svg').getAttribute('viewBox').split(' ').map(Number);
    const inside = (value, most) => Math.max(2, Math.min(value, most - 2)); // what is far off is at the edge
    const x = value => inside(ax + bx * value, width), y = value => inside(ay + by * value, height);
    left.forEach((steps, i) => {
      const row = channel.rows[i], measured = channel.measured[i], rest = steps * step;
      const at = over ? data.settings[over].values[row] : measured - rest, value = over ? rest : measured;
      if (!known(steps) || !known(at)) return;
      put(group, 'circle', {cx: x(at), cy: y(value), r: 2.4, fill: colour, 'fill-opacity': 0.6},
        `${about(row)}; ${channel.words} ${shown(measured)} ${channel.unit}, predicted ${shown(measured - rest)}`);
    });
    const means = over ? data.means[key][name][over] : []; // of each part the mean, and half of its band
    (over ? data.at[name][over] : []).forEach((middle, i) => {
      const mean = means[2 * i] * step, half = means[2 * i + 1] * step, cx = x(middle), cy = y(mean);
      if (known(means[2 * i + 1])) put(group, 'path', {d: `M${cx} ${y(mean - half)}V${y(mean + half)}`, stroke: colour, 'stroke-width': 1.6});
      put(group, 'rect', {x: cx - 3.2, y: cy - 3.2, width: 6.4, height: 6.4, fill: colour, stroke: 'var(--paper)'});
    });
  }

  function draw() {
    const ticked = [...form.querySelectorAll('input:checked')].map(one => Number(one.value)).sort((a, b) => a - b);
    const key = form.elements.model ? form.elements.model.value : ticked.join(',');
    const view = key in data.left ? key : 'absent';
    for (const part of box.querySelectorAll('[data-view]')) part.hidden = part.dataset.view !== view;
    for (const frame of box.querySelectorAll('[data-over]')) {
      // measured over predicted stands beside residual over the setting
      frame.hidden = ![form.elements.over.value, ''].includes(frame.dataset.over);
      if (frame.hidden) continue;
      const svg = frame.querySelector('svg'), name = frame.dataset.channel + frame.dataset.over;
      marked[name]?.remove();
      marked[name] = svg.appendChild(document.createElementNS(SVG, 'g'));
      points(frame, data.base_key, 'var(--base)', marked[name]);
      if (key !== data.base_key) points(frame, key, 'var(--with)', marked[name]);
    }
  }

  form.addEventListener('change', draw);
  draw();
}
