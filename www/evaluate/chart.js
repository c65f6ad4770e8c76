// Mean angular error against the number of lights, for every planner of the run.

import { download, find, html, set, svg } from "../svg.js";
import { copyStyles } from "../dome.js";
import { dash, errorText, label, marker, seriesColour, solverLabel } from "./series.js";

/** @typedef {import("./evaluate.js").Panel} Panel */
/** @typedef {import("./evaluate.js").State} State */

const MARGIN = { left: 40, right: 128, top: 12, bottom: 34 };
const HEIGHT = 280;
/** Where names don't fit beside the curves they are below, two a line of this height. */
const LEGEND_LINE = 20;
/** A normal needs so many lights. */
const FIRST = 3;

/**
 * @param {HTMLElement} root
 * @param {Panel} panel
 */
export function mountChart(root, { store, actions }) {
  root.innerHTML = `
    <div class="head"><h2 id="chart-title">Error against lights</h2><button type="button" class="button small save" disabled>Save SVG</button></div>
    <div class="chart"></div>
    <p class="note"></p>`;
  const title = find(root, "h2", HTMLElement);
  const host = find(root, ".chart", HTMLElement);
  const note = find(root, ".note", HTMLElement);
  const save = find(root, ".save", HTMLButtonElement);

  save.addEventListener("click", () => {
    const drawing = host.querySelector("svg");
    if (!drawing) return;
    const copy = /** @type {SVGSVGElement} */ (drawing.cloneNode(true));
    copyStyles(drawing, copy);
    set(copy, { width: drawing.clientWidth });
    download(new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }), `${store.state.object?.name ?? "object"}-${store.state.shown.solver}-error.svg`);
  });

  const redraw = () => {
    const { state } = store;
    const series = seriesOf(state);
    const known = state.object?.truth !== false;
    title.textContent = known ? "Error against lights" : "Predicted error against lights";
    save.disabled = !series.length;
    if (!series.length) {
      host.replaceChildren(html("p", { class: "empty-note" }, "The curves appear while the planners run."));
      note.textContent = "";
      return;
    }
    host.replaceChildren(plot(series, Math.max(280, host.clientWidth), state, known, actions));
    const missing = state.runs.size && !state.running && series.some(({ planner, points }) => points.length < (state.runs.get(planner)?.length ?? 0) - FIRST);
    note.textContent = `${missing ? "The curves are being completed. " : ""}First draw of each planner, ${solverLabel(state.catalogue, state.shown.solver).toLowerCase()}. ${known ? "Lower is better; the oracle sees the truth." : "What the solver itself expects, as this object has no true normals: planners that differ by little may truly be the other way round."}`;
  };
  store.watch(["runs", "shown", "object"], redraw);
  let width = 0;
  new ResizeObserver(() => {
    if (host.clientWidth === width) return;
    width = host.clientWidth;
    redraw();
  }).observe(host);
}

/** @typedef {{ planner: string, points: { t: number, error: number }[] }} Series */

/**
 * @param {Readonly<State>} state
 * @returns {Series[]}
 */
function seriesOf({ runs, shown, ran }) {
  return (ran?.planners ?? []).filter(planner => planner !== "all").flatMap(planner => {
    const points = (runs.get(planner) ?? []).flatMap(({ errors }, i) => {
      const error = errors[shown.solver];
      return typeof error === "number" ? [{ t: i + 1, error }] : [];
    });
    return points.length ? [{ planner, points }] : [];
  });
}

/**
 * @param {Series[]} series
 * @param {number} width
 * @param {Readonly<State>} state
 * @param {boolean} known whether there are true normals
 * @param {Panel["actions"]} actions
 */
function plot(series, width, { shown, catalogue, ran }, known, actions) {
  const last = Math.max(ran?.lights[0] ?? FIRST, FIRST + 1);
  const values = series.flatMap(({ points }) => points.map(p => p.error));
  const ticks = niceTicks(Math.min(...values), Math.max(...values));
  const [low, high] = [ticks[0], ticks[ticks.length - 1]];
  const narrow = width < 460;
  const right = narrow ? 56 : MARGIN.right;
  const x = (/** @type {number} */ t) => MARGIN.left + (width - MARGIN.left - right) * (t - FIRST) / (last - FIRST);
  const y = (/** @type {number} */ v) => HEIGHT - MARGIN.bottom - (HEIGHT - MARGIN.top - MARGIN.bottom) * (v - low) / (high - low);
  const height = HEIGHT + (narrow ? 10 + LEGEND_LINE * Math.ceil(series.length / 2) : 0);
  const drawing = svg("svg", { viewBox: `0 0 ${width} ${height}`, height, role: "img", "aria-label": spoken(series, known, catalogue) });
  for (const tick of ticks) {
    drawing.append(
      svg("line", { class: "axis-line", x1: MARGIN.left, x2: width - right, y1: y(tick), y2: y(tick) }),
      svg("text", { class: "tick", x: MARGIN.left - 7, y: y(tick) + 4, "text-anchor": "end" }, `${tick}°`),
    );
  }
  const every = Math.ceil((last - FIRST) / 10);
  for (let t = FIRST; t <= last; t += every) {
    drawing.append(svg("text", { class: "tick", x: x(t), y: HEIGHT - MARGIN.bottom + 17, "text-anchor": "middle" }, String(t)));
  }
  drawing.append(svg("text", { class: "tick", x: (MARGIN.left + width - right) / 2, y: HEIGHT - 3, "text-anchor": "middle" }, "lights"));
  if (shown.step >= FIRST && shown.step <= last) {
    drawing.append(svg("line", { class: "cursor", x1: x(shown.step), x2: x(shown.step), y1: MARGIN.top, y2: HEIGHT - MARGIN.bottom }));
  }
  // The run that is shown is drawn last, on top.
  const order = [...series].sort((a, b) => Number(a.planner === shown.planner) - Number(b.planner === shown.planner));
  for (const { planner, points } of order) {
    const group = svg("g", { style: seriesColour(planner) });
    const d = points.map(({ t, error }, i) => `${i ? "L" : "M"}${x(t).toFixed(1)} ${y(error).toFixed(1)}`).join("");
    group.append(svg("path", { class: `series${planner === shown.planner ? " shown" : ""}`, d, "stroke-dasharray": dash(planner) }));
    if (last - FIRST <= 30) {
      for (const { t, error } of points) {
        const solid = planner === shown.planner && t === shown.step;
        group.append(marker(planner, x(t), y(error), solid ? 5 : 3.4, `dot${solid ? " solid" : ""}`));
      }
    }
    drawing.append(group);
  }
  // Names at the ends of the curves, moved apart where they would overlap.
  const ends = series.map(({ planner, points }) => ({ planner, end: points[points.length - 1], at: y(points[points.length - 1].error) }))
    .sort((a, b) => a.at - b.at);
  ends.forEach((end, i) => { if (i) end.at = Math.max(end.at, ends[i - 1].at + 15); });
  const overflow = Math.max(0, (ends[ends.length - 1]?.at ?? 0) - (HEIGHT - MARGIN.bottom));
  for (const { planner, end, at } of ends) {
    const text = svg("text", { class: "end", style: seriesColour(planner), x: width - right + 10, y: at - overflow + 4 },
      `${errorText(end.error, known)}${narrow ? "" : ` ${shortLabel(label(catalogue, planner))}`}`);
    drawing.append(text);
  }
  if (narrow) {
    series.forEach(({ planner }, i) => {
      const [left, middle] = [(i % 2) * width / 2, HEIGHT + 10 + LEGEND_LINE * (i >> 1)];
      drawing.append(svg("g", { style: seriesColour(planner) },
        svg("path", { class: "series", d: `M${left} ${middle}h26`, "stroke-dasharray": dash(planner) }),
        marker(planner, left + 13, middle, 3.4, "dot"),
        svg("text", { class: "end", x: left + 34, y: middle + 4 }, shortLabel(label(catalogue, planner)))));
    });
  }
  drawing.addEventListener("click", event => {
    const box = drawing.getBoundingClientRect();
    const t = FIRST + (event.clientX - box.left - MARGIN.left) / (box.width - MARGIN.left - right) * (last - FIRST);
    actions.show({ step: Math.round(t) });
  });
  return drawing;
}

/** @param {string} text */
function shortLabel(text) {
  return text.replace(/ \(.*\)/, "").replace("ring + vertical", "ring+v");
}

/**
 * Round numbers from just below `low` to just above `high`.
 * @param {number} low
 * @param {number} high
 */
function niceTicks(low, high) {
  const rough = Math.max(high - low, 0.2) / 5;
  const unit = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(f => f * unit).find(s => s >= rough) ?? unit;
  const first = Math.floor(low / step);
  const count = Math.max(1, Math.ceil(high / step) - first);
  return Array.from({ length: count + 1 }, (_, i) => Number(((first + i) * step).toFixed(6)));
}

/**
 * @param {Series[]} series
 * @param {boolean} known
 * @param {State["catalogue"]} catalogue
 */
function spoken(series, known, catalogue) {
  const ends = series.map(({ planner, points }) => {
    const end = points[points.length - 1];
    return `${label(catalogue, planner)} ${errorText(end.error, known)} with ${end.t}`;
  });
  return `${known ? "Mean" : "Predicted mean"} angular error against the number of lights. ${ends.join("; ")}. The numbers are in the table.`;
}
