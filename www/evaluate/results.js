// The table, and all that can be taken away.

import { find, html } from "../svg.js";
import { EXPORTS, waiting } from "./export.js";
import { errorText, label, seriesColour, solverLabel, swatch } from "./series.js";

/** @typedef {import("./evaluate.js").Panel} Panel */
/** @typedef {import("../messages.js").ResultRow} ResultRow */

/** The table of more solvers than this needs the whole width. */
const MOST_BESIDE_CHART = 2;

/**
 * @param {HTMLElement} root
 * @param {Panel} panel
 */
export function mountResults(root, { page, store, actions }) {
  root.innerHTML = `
    <div class="head"><h2 id="results-title">Results</h2>
      <details class="menu"><summary class="button small">Export</summary><div><p class="note" hidden></p></div></details></div>
    <div class="scroll" tabindex="0" role="region" aria-label="Table of results"></div>
    <p class="note" id="results-note"></p>`;
  const scroll = find(root, ".scroll", HTMLElement);
  const note = find(root, "#results-note", HTMLElement);
  const menu = find(root, ".menu", HTMLDetailsElement);
  const list = find(menu, "div", HTMLElement);
  const wait = find(list, ".note", HTMLElement);

  for (const { name, ready, save } of EXPORTS) {
    const button = html("button", { type: "button" }, name);
    button.addEventListener("click", async () => {
      menu.open = false;
      find(menu, "summary", HTMLElement).focus();
      try {
        await save(page, store);
        page.announce(`${name} was saved.`);
      } catch (error) {
        page.problem(`“${name}” could not be saved`, error);
      }
    });
    store.watch(["object", "report", "view", "shown", "relit"], state => { button.disabled = !ready(state); });
    list.append(button);
  }
  store.watch(["view", "shown"], state => {
    wait.textContent = waiting(state);
    wait.hidden = !wait.textContent;
  });
  menu.addEventListener("keydown", event => {
    if (event.key !== "Escape" || !menu.open) return;
    menu.open = false;
    find(menu, "summary", HTMLElement).focus();
  });
  document.addEventListener("click", event => {
    if (event.target instanceof Node && !menu.contains(event.target)) menu.open = false;
  });

  store.watch(["rows", "shown", "ran", "running"], ({ rows, object, shown, ran, catalogue, running }) => {
    if (!rows.length) {
      note.textContent = "";
      scroll.replaceChildren(html("p", { class: "empty-note" }, running ? "Running…" : "No result yet: choose planners and press Run."));
      return;
    }
    const place = (/** @type {ResultRow} */ row) => ran?.planners.indexOf(row.planner) ?? 0;
    const solvers = [...new Set(rows.map(row => row.solver))];
    const blended = rows.some(row => (row.effective_images ?? 1) > 1.01);
    const fair = rows.filter(row => !row.oracle && row.planner !== "all");
    const best = Math.min(...fair.flatMap(row => row.mae ?? []));
    const known = object?.truth !== false;
    const single = known ? ["MAE", "95 % interval"] : ["Predicted MAE"];
    const head = ["Planner", "T", ...(solvers.length > 1 ? solvers.map(solver => solverLabel(catalogue, solver)) : single), ...(blended ? ["Photos"] : []), "Off by"];
    const planners = Map.groupBy([...rows].sort((a, b) => place(a) - place(b)), row => row.planner);
    const body = [...planners].map(([planner, group]) => {
      const [first] = group;
      const chosen = planner === shown.planner;
      const line = html("tr", { style: seriesColour(planner), class: [chosen && "chosen", first.error && "failed"].filter(Boolean).join(" ") || null });
      const show = html("button", { type: "button", class: "link", "aria-pressed": String(chosen), "data-shows": planner }, swatch(planner), label(catalogue, planner));
      show.addEventListener("click", () => actions.show({ planner }));
      line.append(html("th", { scope: "row" }, show));
      if (group.every(row => row.error)) {
        line.append(html("td", { colspan: head.length - 1 }, first.error ?? ""));
        return line;
      }
      line.append(html("td", {}, first.lights_taken === undefined ? String(first.lights) : first.lights_taken.toFixed(1)));
      if (solvers.length > 1) for (const row of group) line.append(cell(row));
      else line.append(html("td", { class: mark(first) }, degrees(first)), ...(known ? [html("td", {}, interval(first))] : []));
      line.append(
        ...(blended ? [html("td", {}, first.effective_images?.toFixed(1) ?? "")] : []),
        html("td", {}, first.deviation === null ? "" : `${first.deviation.toFixed(1)}°`),
      );
      return line;
    });

    /** @param {ResultRow} row */
    function mark(row) {
      return row.mae !== null && row.mae <= best && !row.oracle ? "best" : null;
    }

    /** One planner with one solver, which a click shows. @param {ResultRow} row */
    function cell(row) {
      if (row.error) return html("td", {}, row.error);
      const pressed = row.planner === shown.planner && row.solver === shown.solver;
      const half = row.ci95 ? ((row.ci95[1] - row.ci95[0]) / 2).toFixed(2) : "0.00";
      const show = html("button", { type: "button", class: "link", "aria-pressed": String(pressed), "data-shows": `${row.planner} ${row.solver}`, "aria-label": `${degrees(row)}, ${label(catalogue, row.planner)}, ${solverLabel(catalogue, row.solver)}` }, degrees(row));
      show.addEventListener("click", () => actions.show({ planner: row.planner, solver: row.solver }));
      return html("td", { class: mark(row) }, show, ...(half === "0.00" ? [] : [html("small", {}, `±${half}`)]));
    }

    root.classList.toggle("wide", solvers.length > MOST_BESIDE_CHART);
    const caption = ran ? [
      `${known ? "Mean" : "Predicted mean"} angular error over ${ran.draws} ${ran.draws === 1 ? "run" : "runs"}, protocol ${ran.protocol}, look-up ${ran.lookups.join(", ")}, seed ${ran.seed}.`,
      !known && "This object has no true normals: shown is what each solver expects its own error to be.",
      known && solvers.length > 1 && ran.draws > 1 && "± is half of the 95 % interval.",
      "“Off by”: mean angle between the light asked for and the light used.",
      ran.stop_at && `Runs end where ${solverLabel(catalogue, ran.solvers[0])} predicts at most ${ran.stop_at}°; T is the mean of what was taken.`,
    ] : [];
    note.textContent = caption.filter(Boolean).join(" ");
    const held = scroll.contains(document.activeElement) ? document.activeElement?.getAttribute("data-shows") : null;
    scroll.replaceChildren(html("table", { "aria-labelledby": "results-title", "aria-describedby": "results-note" },
      html("thead", {}, html("tr", {}, ...head.map(text => html("th", { scope: "col" }, text)))), html("tbody", {}, ...body)));
    if (held) [...scroll.querySelectorAll("button")].find(button => button.dataset.shows === held)?.focus({ preventScroll: true });
  });
}

/** @param {ResultRow} row */
function degrees({ mae, predicted_mae }) {
  const error = mae ?? predicted_mae;
  return error === undefined ? "unknown" : errorText(error, mae !== null);
}

/** @param {ResultRow} row */
function interval(row) {
  if (row.mae === null) return "unknown";
  if (!row.ci95) return "one run";
  const [low, high] = row.ci95.map(value => value.toFixed(2));
  return low === high ? "exact" : `${low}–${high}°`;
}
