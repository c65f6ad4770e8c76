// The page: starts the worker, shows the views as tabs, reports problems.
//
// A view is a module with `mount(root, page)`; it is loaded when its tab is first opened. To add one, give it a line
// in VIEWS and a module (as `rig/rig.js`). What it gets is a `Page`:
//   page.engine    calls to the worker that computes everything (engine.js, messages.js)
//   page.announce  says something to people who listen to the page
//   page.problem   shows what went wrong and what to do about it; returns nothing, never throws
//   page.mended    takes back what was shown under one of these titles
// `Dome` (dome.js), `draw` (svg.js) and `Store` (store.js) are for every view.

import { Engine, isAbort } from "./engine.js";
import { find, html } from "./svg.js";

/**
 * @typedef {object} Page
 * @property {Engine} engine
 * @property {(text: string) => void} announce
 * @property {(title: string, error: unknown, advice?: string) => void} problem
 * @property {(...titles: string[]) => void} mended
 *
 * @typedef {{ mount: (root: HTMLElement, page: Page) => void | Promise<void> }} ViewModule
 * @typedef {{ id: string, title: string, load: () => Promise<ViewModule> }} View
 */

/** @type {View[]} */
const VIEWS = [
  { id: "evaluate", title: "Evaluate", load: () => import("./evaluate/evaluate.js") },
  { id: "rig", title: "Rig", load: () => import("./rig/rig.js") },
];

/** So many announcements stay, for those who read them later. */
const ANNOUNCEMENTS = 5;

/** What was shown last. @type {unknown} */
let reported = null;

const problems = find(document, "#problems", HTMLElement);
const announcements = find(document, "#announcements", HTMLElement);

/** @type {Page} */
const page = {
  engine: new Engine(),

  // Each is added: what comes at the same time must not wipe the other out before it is read.
  announce(text) {
    announcements.append(html("p", {}, text));
    while (announcements.childElementCount > ANNOUNCEMENTS) announcements.firstElementChild?.remove();
  },

  problem(title, error, advice) {
    // A worker that has failed fails all its requests: the first title says best what happened.
    if (isAbort(error) || error instanceof Error && error === reported) return;
    reported = error;
    const said = error instanceof Error ? error.message : String(error);
    const close = html("button", { class: "button small", type: "button" }, "Dismiss");
    const card = html("section", { class: "problem", "aria-label": title }, html("h2", {}, title), close, html("p", { class: "said" }, said));
    if (advice) card.append(html("p", {}, advice));
    close.addEventListener("click", () => {
      card.remove();
      find(document, "#content", HTMLElement).focus();
    });
    problems.replaceChildren(card);
    card.scrollIntoView({ block: "nearest" });
  },

  mended(...titles) {
    const card = problems.firstElementChild;
    if (titles.includes(card?.getAttribute("aria-label") ?? "")) card?.remove();
  },
};

page.engine.onCrash = error => page.problem(
  "The page's worker has failed", error,
  "Reload the page. It needs Chrome or Edge 123, Firefox 121, Safari 17.5, or newer.",
);

addEventListener("unhandledrejection", event => page.problem(
  "Something went wrong", event.reason, "What was captured is stored. Reload the page, and tell us what you did.",
));

/** @type {Map<string, { tab: HTMLButtonElement, panel: HTMLElement, view: View, mounted: boolean }>} */
const tabs = new Map();

/** @param {string} id */
function show(id) {
  for (const [name, { tab, panel }] of tabs) {
    const chosen = name === id;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    panel.hidden = !chosen;
  }
  const entry = tabs.get(id);
  if (!entry || entry.mounted) return;
  entry.mounted = true;
  entry.view.load()
    .then(module => module.mount(entry.panel, page))
    .catch(error => page.problem(`The view “${entry.view.title}” could not be opened`, error, "Reload the page."));
}

const bar = find(document, "#views", HTMLElement);
for (const view of VIEWS) {
  const tab = html("button", { type: "button", role: "tab", id: `tab-${view.id}`, "aria-controls": `view-${view.id}` }, view.title);
  let panel = document.getElementById(`view-${view.id}`);
  if (!panel) {
    panel = html("section", { id: `view-${view.id}`, role: "tabpanel", "aria-labelledby": tab.id, hidden: true });
    find(document, "#content", HTMLElement).append(panel);
  }
  tab.addEventListener("click", () => show(view.id));
  tabs.set(view.id, { tab, panel, view, mounted: false });
  bar.append(tab);
}
bar.hidden = VIEWS.length < 2;
bar.addEventListener("keydown", event => {
  const ids = [...tabs.keys()];
  const now = ids.findIndex(id => tabs.get(id)?.tab === document.activeElement);
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (now < 0 || !step) return;
  const next = ids[(now + step + ids.length) % ids.length];
  show(next);
  tabs.get(next)?.tab.focus();
});
show(VIEWS[0].id);
