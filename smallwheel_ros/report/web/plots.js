/* SPDX-License-Identifier: Apache-2.0 */
// Plots of the page: axes, zoom and cursor are uPlot's, what stands in them is drawn here.
'use strict';

const plots = new Set();

/** A number on an axis: 2000, 0.01, 1.1·10⁶, 10⁻⁵. */
function tick(value) {
  const short = Number(value.toPrecision(6)), size = Math.abs(short);
  if (!size || (size >= 1e-4 && size < 1e6)) return String(short);
  const digits = short.toExponential().split('e')[0].replace(/\D/g, '').length - 1;
  return power(short, digits);
}

/**
 * A plot in `box`. spec: title, label (for those who cannot see it), height; x, y: {label, range, log,
 * down}; equal: one scale for both; layers, drawn in their order:
 *   {kind: 'points', x, y, low, high, colour, mark, faded(i), lines(i), click(i)}   low, high: whiskers
 *   {kind: 'line', x, y, low, high, colour, dash, dots, width}   null is a gap
 *   {kind: 'band', low, high, slope}   around 0, or around the diagonal
 *   {kind: 'way', x, y, value, ramp}   a line coloured piece by piece
 *   {kind: 'events', at, colour}   vertical lines
 * moved(x): told where the cursor is on the x-axis, null where it left.
 */
class Plot {
  constructor(box, spec) {
    this.box = box;
    this.spec = spec;
    this.at = -1; // place of the keyboard's point
    box.replaceChildren();
    if (spec.title) box.append(el('p', {class: 'title'}, spec.title));
    this.holder = box.appendChild(el('div', {
      tabindex: 0, role: 'img', 'aria-roledescription': 'plot; arrow keys go through its points',
      'aria-label': spec.label || spec.title,
    }));
    this.points = this.candidates();
    this.make();
    this.holder.addEventListener('keydown', event => this.key(event));
    this.holder.addEventListener('blur', () => this.leave());
    plots.add(this);
  }

  make() {
    const {x, y, height = 260} = this.spec;
    this.width = this.room();
    const axis = (side, label, size) => ({
      label, size, labelSize: 20, gap: 4, font: '11px system-ui, sans-serif',
      labelFont: '12px system-ui, sans-serif', stroke: () => colour('--ink'),
      grid: {stroke: () => colour('--grid'), width: 1}, ticks: {show: false},
      values: (u, splits) => splits.map(value => (value === null ? ''
        : tick(value))),
      side,
    });
    const ranges = this.ranges(height);
    this.plot = new uPlot({
      width: this.width, height, legend: {show: false},
      padding: [8, 12, 0, 0],
      scales: {
        x: {time: false, distr: x.log ? 3 : 1},
        y: {range: () => ranges.y, distr: y.log ? 3 : 1, dir: y.down ? -1 : 1},
      },
      axes: [axis(2, x.label, 34), axis(3, y.label, 52)],
      series: [{}, {paths: () => null, points: {show: false}}],
      cursor: {drag: {x: true, y: !this.spec.moved, uni: 20}, points: {show: false}, y: false,
               x: Boolean(this.spec.moved)},
      hooks: {draw: [u => this.draw(u)], setCursor: [u => this.hover(u)]},
    }, [ranges.x, [null, null]], this.holder);
    this.plot.over.addEventListener('click', () => this.nearest && this.nearest.layer.click?.(this.nearest.i));
    this.plot.over.addEventListener('mouseleave', () => this.leave());
  }

  room() { return Math.max(200, Math.floor(this.box.clientWidth)); }

  /** Ranges of both axes; with one scale for both, the shorter one is widened. */
  ranges(height) {
    const {x, y, equal} = this.spec;
    if (!equal) return {x: x.range, y: y.range};
    const across = this.width - 84, along = height - 64;
    const unit = Math.max((x.range[1] - x.range[0]) / across, (y.range[1] - y.range[0]) / along) || 1;
    const wide = ([low, high], pixels) => {
      const middle = (low + high) / 2;
      return [middle - unit * pixels / 2, middle + unit * pixels / 2];
    };
    return {x: wide(x.range, across), y: wide(y.range, along)};
  }

  /** Follow the width that there is; colours are read anew where the plot is made anew. */
  fit(anew = false) {
    if (!anew && Math.abs(this.room() - this.width) < 2) return;
    this.plot.destroy();
    this.make();
  }

  end() {
    this.plot.destroy();
    plots.delete(this);
  }

  // Drawing; all in pixels of the canvas.

  draw(u) {
    const {ctx, bbox} = u, scale = devicePixelRatio;
    const px = value => u.valToPos(value, 'x', true), py = value => u.valToPos(value, 'y', true);
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const layer of this.spec.layers) this['draw_' + layer.kind](ctx, layer, px, py, scale, u);
    ctx.restore();
  }

  draw_band(ctx, {low, high, slope = 0}, px, py, scale, u) {
    const {min, max} = u.scales.x;
    ctx.fillStyle = colour('--band');
    ctx.beginPath();
    ctx.moveTo(px(min), py(slope * min + low));
    ctx.lineTo(px(max), py(slope * max + low));
    ctx.lineTo(px(max), py(slope * max + high));
    ctx.lineTo(px(min), py(slope * min + high));
    ctx.fill();
    ctx.strokeStyle = colour('--base');
    ctx.lineWidth = scale;
    ctx.beginPath();
    ctx.moveTo(px(min), py(slope * min));
    ctx.lineTo(px(max), py(slope * max));
    ctx.stroke();
  }

  draw_points(ctx, layer, px, py, scale) {
    for (const faded of [true, false]) {
      ctx.fillStyle = ctx.strokeStyle = faded ? colour('--gone') : colour(layer.colour);
      ctx.globalAlpha = faded ? 1 : layer.alpha ?? 0.7;
      ctx.lineWidth = 1.5 * scale;
      for (let i = 0; i < layer.x.length; i++) {
        if (!known(layer.x[i]) || !known(layer.y[i]) || Boolean(layer.faded?.(i)) !== faded) continue;
        const x = px(layer.x[i]), y = py(layer.y[i]), r = (layer.size ?? 3) * scale;
        ctx.beginPath();
        if (layer.mark === 'cross') {
          ctx.moveTo(x - r, y - r); ctx.lineTo(x + r, y + r);
          ctx.moveTo(x - r, y + r); ctx.lineTo(x + r, y - r);
          ctx.stroke();
        } else {
          ctx.arc(x, y, r, 0, 2 * Math.PI);
          ctx.fill();
        }
        if (layer.low) this.whisker(ctx, x, py(layer.low[i]), py(layer.high[i]), scale);
      }
    }
    ctx.globalAlpha = 1;
  }

  whisker(ctx, x, low, high, scale) {
    ctx.lineWidth = scale;
    ctx.beginPath();
    ctx.moveTo(x, low);
    ctx.lineTo(x, high);
    ctx.stroke();
  }

  draw_line(ctx, layer, px, py, scale) {
    const {x, y, low, high} = layer;
    ctx.fillStyle = ctx.strokeStyle = colour(layer.colour);
    if (low && !layer.dots) {
      ctx.globalAlpha = 0.2;
      pieces(x, low, high).forEach(([from, to]) => {
        ctx.beginPath();
        for (let i = from; i < to; i++) ctx.lineTo(px(x[i]), py(low[i]));
        for (let i = to - 1; i >= from; i--) ctx.lineTo(px(x[i]), py(high[i]));
        ctx.fill();
      });
      ctx.globalAlpha = 1;
    }
    ctx.lineWidth = (layer.width ?? 1.7) * scale;
    ctx.setLineDash((layer.dash || []).map(part => part * scale));
    ctx.beginPath();
    pieces(x, y, y).forEach(([from, to]) => {
      ctx.moveTo(px(x[from]), py(y[from]));
      if (to === from + 1) ctx.lineTo(px(x[from]) + scale, py(y[from]));
      for (let i = from + 1; i < to; i++) ctx.lineTo(px(x[i]), py(y[i]));
    });
    ctx.stroke();
    ctx.setLineDash([]);
    if (!layer.dots) return;
    for (let i = 0; i < x.length; i++) {
      if (!known(y[i])) continue;
      ctx.beginPath();
      ctx.arc(px(x[i]), py(y[i]), 3.5 * scale, 0, 2 * Math.PI);
      ctx.fill();
      if (low && known(low[i])) this.whisker(ctx, px(x[i]), py(low[i]), py(high[i]), scale);
    }
  }

  draw_way(ctx, {x, y, value, ramp}, px, py, scale) {
    ctx.lineCap = 'round';
    const parts = [[8, () => colour('--soft')], [6, i => (known(value[i]) ? ramp(value[i]) : colour('--gone'))]];
    for (const [width, shade] of parts) { // an edge first: no colour is lost on the page's own
      ctx.lineWidth = width * scale;
      for (let i = 0; i + 1 < x.length; i++) {
        if (!known(x[i]) || !known(x[i + 1])) continue;
        ctx.strokeStyle = shade(i);
        ctx.beginPath();
        ctx.moveTo(px(x[i]), py(y[i]));
        ctx.lineTo(px(x[i + 1]), py(y[i + 1]));
        ctx.stroke();
      }
    }
  }

  draw_events(ctx, {at, colour: name}, px, py, scale, u) {
    ctx.strokeStyle = colour(name);
    ctx.lineWidth = 1.2 * scale;
    ctx.setLineDash([3 * scale, 3 * scale]);
    for (const x of at) {
      ctx.beginPath();
      ctx.moveTo(px(x), u.bbox.top);
      ctx.lineTo(px(x), u.bbox.top + u.bbox.height);
      ctx.stroke();
    }
    ctx.setLineDash([]);
  }

  // Pointing: by mouse, by finger, by keyboard.

  /** Points that something can be said of, from left to right. */
  candidates() {
    const found = [];
    for (const layer of this.spec.layers) {
      if (!layer.lines) continue;
      layer.x.forEach((x, i) => known(x) && known(layer.y[i]) && found.push({layer, i, x, y: layer.y[i]}));
    }
    return found.sort((a, b) => a.x - b.x);
  }

  hover(u) {
    const {left, top} = u.cursor;
    if (left < 0 || this.told) return;
    let nearest = null, least = this.spec.moved ? Infinity : 22 * 22;
    for (const point of this.points) {
      const dx = u.valToPos(point.x, 'x') - left, dy = u.valToPos(point.y, 'y') - top;
      const far = this.spec.equal || !this.spec.moved ? dx * dx + dy * dy : 1000 * dx * dx + dy * dy;
      if (far < least) [least, nearest] = [far, point];
    }
    this.point(nearest);
  }

  point(found) {
    this.nearest = found;
    const u = this.plot, frame = u.over.getBoundingClientRect();
    u.over.style.cursor = found?.layer.click ? 'pointer' : '';
    if (!found) {
      showTip(null);
      this.mark(null);
      return;
    }
    this.mark(found.x, found.y);
    const x = frame.left + u.valToPos(found.x, 'x'), y = frame.top + u.valToPos(found.y, 'y');
    showTip(found.layer.lines(found.i), x, y);
    this.spec.moved?.(this.spec.equal ? found.layer.time[found.i] : found.x, this);
  }

  /** A ring around a point; null takes it away. */
  mark(x, y) {
    this.ring ??= el('div', {class: 'mark'});
    this.ring.hidden = !known(x) || !known(y);
    if (this.ring.hidden) return;
    this.plot.over.append(this.ring);
    this.ring.style.left = `${this.plot.valToPos(x, 'x')}px`;
    this.ring.style.top = `${this.plot.valToPos(y, 'y')}px`;
  }

  /** Another plot tells where its cursor is; null where it left. */
  follow(x) {
    this.told = true;
    const left = known(x) ? this.plot.valToPos(x, 'x') : -10;
    this.plot.setCursor({left, top: left < 0 ? -10 : 0}, true);
    this.told = false;
  }

  leave() {
    this.at = -1;
    this.point(null);
    this.spec.moved?.(null, this);
  }

  key(event) {
    const step = {ArrowRight: 1, ArrowLeft: -1, PageDown: 20, PageUp: -20}[event.key];
    if (step && this.points.length) {
      this.at = Math.max(0, Math.min(this.at + step, this.points.length - 1));
      const found = this.points[this.at];
      this.point(found);
      say(found.layer.lines(found.i).join(', '));
    } else if (event.key === 'Enter' && this.nearest?.layer.click) {
      this.nearest.layer.click(this.nearest.i);
    } else if (event.key === 'Escape') {
      this.leave();
    } else if (event.key === '+' || event.key === '-') {
      const {min, max} = this.plot.scales.x, half = (max - min) / (event.key === '+' ? 4 : 1);
      const middle = this.nearest?.x ?? (min + max) / 2;
      this.plot.setScale('x', {min: middle - half, max: middle + half});
    } else if (event.key === '0') {
      this.plot.setData(this.plot.data, true);
    } else {
      return;
    }
    event.preventDefault();
  }
}

/** Where a line is known without a gap: pairs of begin and end. */
function pieces(x, y, z) {
  const found = [];
  let from = -1;
  for (let i = 0; i <= x.length; i++) {
    const here = i < x.length && known(x[i]) && known(y[i]) && known(z[i]);
    if (here && from < 0) from = i;
    if (!here && from >= 0) { found.push([from, i]); from = -1; }
  }
  return found;
}
