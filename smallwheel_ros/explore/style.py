"""Look and script of the page: served by the page's own server, so that it works offline."""

from __future__ import annotations

from smallwheel_ros.report.style import CSS as REPORT

CSS = (
    REPORT
    + """
body { max-width: 84rem; padding: 0; display: grid; grid-template-columns: 19rem minmax(0, 1fr); }
form { position: sticky; top: 0; height: 100vh; overflow-y: auto; padding: 1.4rem 1.2rem;
  background: var(--wash); border-right: 1px solid var(--line); font-size: .9rem; }
main { padding: 1rem 1.6rem 3rem; transition: opacity .15s .15s; }
main.busy { opacity: .45; }
form h1 { font-size: 1.05rem; overflow-wrap: anywhere; }
form p { color: var(--soft); margin: 0 0 .8rem; }
form .hint { font-size: .78rem; line-height: 1.4; }
fieldset { border: 0; padding: 0; margin: 0 0 .6rem; }
legend { font-weight: 600; padding: 0 0 .2rem; }
fieldset label { display: flex; gap: .45rem; align-items: baseline; padding: .13rem 0;
  cursor: pointer; line-height: 1.35; }
fieldset label span { flex: 1; }
fieldset .off { color: #858c96; cursor: default; }
small { display: block; font-size: .76rem; }
label b { width: 3.4rem; text-align: right; font-weight: 400; font-size: .8rem; padding: 0 .25rem;
  border-radius: 2px; font-variant-numeric: tabular-nums;
  background: linear-gradient(to right, #b9d9ec var(--share), #e9edf1 0); }
select, button { font: inherit; width: 100%; margin: .2rem 0 .8rem; padding: .35rem .5rem; }
button { border: 1px solid var(--accent); border-radius: 4px; background: #fff;
  color: var(--accent); cursor: pointer; }
button:hover { background: #eef5fa; }
main .callout { margin-top: 0; max-width: none; }
main figure { margin: .6rem 0 1rem; }
@media (max-width: 56rem) { body { display: block; } form { position: static; height: auto; } }
@media print { form { display: none; } body { display: block; } }
"""
)

# One question at a time: what is clicked meanwhile is asked together, when the answer is there.
SCRIPT = """
const form = document.querySelector('form'), main = document.querySelector('main');
let asking = false, changed = false;
async function show() {
  changed = true;
  if (asking) return;
  asking = true;
  main.classList.add('busy');
  while (changed) {
    changed = false;
    const query = new URLSearchParams(new FormData(form));
    history.replaceState(null, '', '?' + query);
    draw(await answer(query));
  }
  main.classList.remove('busy');
  asking = false;
}
async function answer(query) {
  try {
    const reply = await fetch('view?' + query);
    return reply.ok ? await reply.json() : {error: await reply.text()};
  } catch {
    return {error: 'The server has ended. Start smallwheel explore again.'};
  }
}
function draw(answer) {
  if (answer.error) { main.textContent = answer.error; return; }
  main.innerHTML = answer.html;
}
form.addEventListener('change', show);
"""
