/* SPDX-License-Identifier: Apache-2.0 */
// Plots follow page and paper; figures whose data is all that they need; commands to copy.
'use strict';

// All plots follow the width of the page, its colours and the printer.
let waiting = 0;
new ResizeObserver(() => {
  cancelAnimationFrame(waiting);
  waiting = requestAnimationFrame(() => plots.forEach(plot => plot.fit()));
}).observe(document.body);
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
  shades.clear();
  plots.forEach(one => one.plot.redraw());
});
addEventListener('beforeprint', () => {
  ROOT.classList.add('printing');
  shades.clear();
  plots.forEach(plot => {
    plot.room = () => (plot.spec.wide ? 660 : 320); // what A4 and Letter hold
    plot.fit(true);
  });
});
addEventListener('afterprint', () => {
  ROOT.classList.remove('printing');
  shades.clear();
  plots.forEach(plot => { delete plot.room; plot.fit(true); });
});

// Figures whose data is all that they need.
for (const box of document.querySelectorAll('[data-xy]')) {
  const given = DATA[box.dataset.xy], wheel = ['--with', '--w1', '--w2', '--w4', '--w3', '--w5', '--w6'];
  const layers = given.layers.map((layer, i) => ({
    ...layer, colour: layer.colour || wheel[i % wheel.length],
    lines: layer.kind !== 'points' ? undefined : at => [layer.names ? layer.names[at] : layer.name || '',
      `${given.x}: ${number(layer.x[at])}`, `${given.y}: ${number(layer.y[at])}`],
  }));
  const named = layers.filter(layer => layer.name);
  const part = el('div', {class: 'plot'});
  box.prepend(part);
  if (named.length > 1) part.after(legend(named.map(layer => [layer.colour, layer.name, layer.dash])));
  new Plot(part, {
    label: given.label, height: given.height, wide: true,
    x: {label: given.x, range: given.x_range || span(layers.map(layer => layer.x))},
    y: {label: given.y, range: given.y_range || span(layers.flatMap(l => [l.y, l.low || [], l.high || []]))},
    layers,
  });
}
for (const button of document.querySelectorAll('.copy button')) {
  button.addEventListener('click', async () => {
    const code = button.parentNode.querySelector('code');
    try {
      await navigator.clipboard.writeText(code.textContent);
      say('copied');
      button.textContent = 'copied';
    } catch { // a browser that keeps the clipboard to itself: marked, to copy by hand
      getSelection().selectAllChildren(code);
    }
  });
}
