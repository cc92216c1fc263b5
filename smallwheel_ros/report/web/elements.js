/* SPDX-License-Identifier: Apache-2.0 */
// What the parts of a page share: elements, numbers, what is said of a point.
// Text reaches the page by textContent alone: names in data are never read as HTML.
'use strict';

const DATA = JSON.parse(document.getElementById('data').textContent);
const ROOT = document.documentElement;
const shades = new Map(); // asking for one makes the browser lay out the page: once is enough

function colour(name) {
  if (!shades.has(name)) shades.set(name, getComputedStyle(ROOT).getPropertyValue(name).trim() || name);
  return shades.get(name);
}

/** An element with attributes, and texts or elements inside; null and undefined are left out. */
function el(tag, attributes = {}, ...inside) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== undefined && value !== null && value !== false) made.setAttribute(name, value);
  }
  made.append(...inside.filter(one => one !== null && one !== undefined));
  return made;
}

/** A sentence whose `commands` are set as code. */
function prose(text) {
  return text.split('`').map((part, i) => (i % 2 ? el('code', {}, part) : part));
}

/** A number with an exponent as people write it: 1.1·10⁶. */
function power(value, digits) {
  const [size, exponent] = value.toExponential(digits).split('e');
  const raised = String(Number(exponent)).replace(/./g, letter => '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'['-0123456789'.indexOf(letter)]);
  return (Number(size) === 1 && !size.includes('.') ? '' : size + '·') + '10' + raised;
}

/** A number with that many digits, as the rest of the page shows them. */
function number(value, digits = 3) {
  if (value === null || !Number.isFinite(value)) return '-';
  if (value === 0) return '0';
  const places = digits - 1 - Math.floor(Math.log10(Math.abs(Number(value.toPrecision(digits)))));
  return places < -3 || places > 8 ? power(value, digits - 1)
    : Number(value.toPrecision(digits)).toFixed(Math.max(places, 0));
}

const known = value => value !== null && value !== undefined && Number.isFinite(value);

/** The least and largest of several lists of numbers, with a margin; nothing known is 0 to 1. */
function span(lists, margin = 0.05, most = 1) {
  const values = lists.flat().filter(known).sort((a, b) => a - b);
  if (!values.length) return [0, 1];
  const cut = Math.floor((1 - most) * (values.length - 1));
  const [low, high] = [values[cut], values[values.length - 1 - cut]];
  const room = margin * (high - low) || Math.abs(high) * margin || 0.5;
  return [low - room, high + room];
}

// What is said of a point, beside it and to those who listen.
const tip = document.body.appendChild(el('div', {class: 'tip', hidden: ''}));
const heard = document.body.appendChild(el('div', {class: 'sr', role: 'status', 'aria-live': 'polite'}));

function say(text) { heard.textContent = text; }

function showTip(lines, x, y) {
  tip.hidden = !lines;
  if (!lines) return;
  tip.replaceChildren(...lines.map(line => el('div', {}, line)));
  const room = ROOT.clientWidth - tip.offsetWidth - 8;
  tip.style.left = `${scrollX + Math.max(4, Math.min(x + 14, room))}px`;
  tip.style.top = `${scrollY + (y + 20 + tip.offsetHeight > innerHeight ? y - tip.offsetHeight - 10 : y + 16)}px`;
}

function legend(entries) {
  const dashes = {0: 'solid', 2: 'dotted', 6: 'dashed'};
  return el('div', {class: 'legend'}, ...entries.map(([name, text, dash]) => el('span', {},
    dash ? el('i', {class: 'dash', style: `border-color: var(${name}); border-top-style: ${dashes[dash[0] || 0]}`})
      : el('i', {style: `background: var(${name})`}), text)));
}

function table(header, rows, caption, numbers = [], strong = []) {
  const cells = (tag, texts) => texts.map((text, i) =>
    el(text ? tag : 'td', {class: numbers.includes(i) ? 'number' : null, scope: tag === 'th' && text ? 'col' : null}, text));
  return el('div', {class: 'scroll', tabindex: 0, role: 'group', 'aria-label': caption || header[0] || 'table'},
    el('table', {}, caption ? el('caption', {}, el('span', {}, caption)) : null,
      el('thead', {}, el('tr', {}, ...cells('th', header))),
      el('tbody', {}, ...rows.map((row, r) =>
        el('tr', {class: strong.includes(r) ? 'strong' : null}, ...cells('td', row))))));
}
