// The table, and all that can be taken away.

import { find, html } from "../svg.js";
import { EXPORTS } from "./export.js";
import { label, seriesColour, solverLabel, swatch } from "./series.js";

/** @typedef {import("./evaluate.js").Panel} Panel */
/** @typedef {import("../messages.js").ResultRow} ResultRow */

/**
 * @param {HTMLElement} root
 * @param {Panel} panel
 */
export function mountResults(root, { page, store, actions }) {
  root.innerHTML = `
    <div class="head"><h2 id="results-title">Results</h2>
      <details class="menu"><summary class="button small">Export</summary><div></div></details></div>
    <div class="scroll" tabindex="0" role="region" aria-label="Table of results"></div>
    <p class="note" id="results-note"></p>`;
  const scroll = find(root, ".scroll", HTMLElement);
  const note = find(root, ".note", HTMLElement);
  const menu = find(root, ".menu", HTMLDetailsElement);
  const list = find(menu, "div", HTMLElement);

  for (const { name, ready, save } of EXPORTS) {
    const button = html("button", { type: "button" }, name);
    button.addEventListener("click", async () => {
      menu.open = false;
      find(menu, "summary", HTMLElement).focus();
      try {
        await save(page, store.state);
        page.announce(`${name} was saved.`);
      } catch (error) {
        page.problem(`“${name}” could not be saved`, error);
      }
    });
    store.watch(["object", "report", "view", "relit"], state => { button.disabled = !ready(state); });
    list.append(button);
  }
  menu.addEventListener("keydown", event => {
    if (event.key !== "Escape" || !menu.open) return;
    menu.open = false;
    find(menu, "summary", HTMLElement).focus();
  });
  document.addEventListener("click", event => {
    if (event.target instanceof Node && !menu.contains(event.target)) menu.open = false;
  });

  store.watch(["rows", "shown", "ran", "running"], ({ rows, shown, ran, catalogue, running }) => {
    if (!rows.length) {
      note.textContent = "";
      scroll.replaceChildren(html("p", { class: "empty-note" }, running ? "Running…" : "No result yet: choose planners and press Run."));
      return;
    }
    const best = Math.min(...rows.filter(row => !row.oracle && row.mae !== null && row.planner !== "all").map(row => row.mae ?? Infinity));
    const solvers = new Set(rows.map(row => row.solver)).size > 1;
    const blended = rows.some(row => (row.effective_images ?? 1) > 1.01);
    const head = ["Planner", ...(solvers ? ["Solver"] : []), "T", "MAE", "95 % interval", ...(blended ? ["Photos"] : []), "Off by"];
    const place = (/** @type {ResultRow} */ row) => ran?.planners.indexOf(row.planner) ?? 0;
    const body = [...rows].sort((a, b) => place(a) - place(b)).map(row => {
      const chosen = row.planner === shown.planner && row.solver === shown.solver;
      const line = html("tr", {
        style: seriesColour(row.planner), class: [chosen && "chosen", row.mae !== null && row.mae <= best && !row.oracle && "best", row.error && "failed"].filter(Boolean).join(" ") || null,
      });
      const show = html("button", { type: "button", class: "link", "aria-pressed": String(chosen) }, swatch(row.planner), label(catalogue, row.planner));
      show.addEventListener("click", () => actions.show({ planner: row.planner, solver: row.solver }));
      line.append(html("th", { scope: "row" }, show));
      if (row.error) {
        line.append(html("td", { colspan: head.length - 1 }, row.error));
        return line;
      }
      if (solvers) line.append(html("td", {}, solverLabel(row.solver)));
      line.append(
        html("td", {}, String(row.lights)),
        html("td", { class: "mae" }, row.mae === null ? "unknown" : `${row.mae.toFixed(2)}°`),
        html("td", {}, interval(row)),
        ...(blended ? [html("td", {}, row.effective_images?.toFixed(1) ?? "")] : []),
        html("td", {}, row.deviation === null ? "" : `${row.deviation.toFixed(1)}°`),
      );
      return line;
    });
    const caption = ran ? `Mean angular error over ${ran.draws} ${ran.draws === 1 ? "run" : "runs"}, protocol ${ran.protocol}, look-up ${ran.lookups.join(", ")}, seed ${ran.seed}. “Off by”: mean angle between the light asked for and the light used.` : "";
    note.textContent = caption;
    scroll.replaceChildren(html("table", { "aria-labelledby": "results-title", "aria-describedby": "results-note" },
      html("thead", {}, html("tr", {}, ...head.map(text => html("th", { scope: "col" }, text)))), html("tbody", {}, ...body)));
  });
}

/** @param {ResultRow} row */
function interval(row) {
  if (!row.ci95) return "one run";
  const [low, high] = row.ci95;
  return low === high ? "exact" : `${low.toFixed(2)}–${high.toFixed(2)}°`;
}
