"""The look of a report: part of the page itself, so that it needs nothing else."""

from __future__ import annotations

CSS = """
:root { --ink: #22262b; --soft: #5d6570; --line: #dfe3e8; --wash: #f6f7f9; --accent: #0072b2; }
* { box-sizing: border-box; }
html { background: var(--wash); -webkit-text-size-adjust: 100%; }
body { margin: 0 auto; max-width: 62rem; padding: 2.2rem 2.6rem 4rem; background: #fff;
  color: var(--ink); font: 16px/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
header { border-bottom: 2px solid var(--ink); padding-bottom: .9rem; margin-bottom: 1.2rem; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 .35rem; }
header p { margin: 0; color: var(--soft); overflow-wrap: anywhere; }
nav { margin: 0 0 1.6rem; font-size: .9rem; line-height: 1.9; }
nav a { color: var(--accent); text-decoration: none; margin-right: 1.1rem; white-space: nowrap; }
nav a:hover { text-decoration: underline; }
h2 { font-size: 1.25rem; line-height: 1.3; margin: 2.4rem 0 .6rem; padding-top: .4rem; }
h3 { font-size: 1.02rem; margin: 1.5rem 0 .4rem; }
p { margin: .5rem 0 .8rem; max-width: 46rem; overflow-wrap: anywhere; }
ul { margin: .4rem 0 .9rem; padding-left: 1.3rem; max-width: 46rem; }
li { margin: .2rem 0; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; margin: .8rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .87rem; line-height: 1.35; min-width: 50%; }
caption { text-align: left; color: var(--soft); font-size: .87rem; padding-bottom: .4rem; }
th, td { padding: .32rem .8rem .32rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); overflow-wrap: break-word; max-width: 26rem; }
th { font-weight: 600; border-bottom: 1.5px solid var(--soft); vertical-align: bottom; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums;
  white-space: nowrap; overflow-wrap: normal; padding-left: .8rem; }
th.number { white-space: normal; }
tr.strong td { font-weight: 600; background: #eef5fa; }
figure { margin: 1.1rem 0 1.5rem; }
figure img { max-width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: .87rem; margin-top: .35rem; max-width: 46rem; }
.callout { border-left: 4px solid var(--accent); background: #eef5fa; padding: .7rem 1rem;
  margin: 1rem 0 1.2rem; max-width: 48rem; }
.callout.warning { border-color: #d55e00; background: #fdf3ec; }
.callout p, .callout ul { margin: .15rem 0; max-width: none; }
.callout .headline { font-size: 1.08rem; font-weight: 600; }
details { margin: .8rem 0; }
summary { cursor: pointer; color: var(--accent); font-size: .92rem; }
footer { margin-top: 3rem; border-top: 1px solid var(--line); padding-top: .7rem;
  color: var(--soft); font-size: .82rem; overflow-wrap: anywhere; }
@media (max-width: 40rem) { body { padding: 1.2rem 1rem 3rem; } }
@media print {
  html, body { background: #fff; }
  body { max-width: none; padding: 0; font-size: 10.5pt; }
  nav { display: none; }
  h2, h3 { break-after: avoid; }
  figure, .callout, .scroll, tr { break-inside: avoid; }
  .scroll { overflow: visible; }
  * { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
}
"""
