// How a planner is drawn everywhere: colour, dash and marker, so that none rests on colour alone.

import { svg } from "../svg.js";

/** @typedef {{ dash: string | null, shape: "circle" | "square" | "triangle" | "diamond" }} Style */

/** @type {Record<string, Style>} */
const STYLES = {
  random: { dash: "2 3", shape: "circle" },
  dc05: { dash: "7 3", shape: "square" },
  dc05v: { dash: null, shape: "square" },
  tk22: { dash: null, shape: "triangle" },
  lipids: { dash: "9 3 2 3", shape: "diamond" },
  coil: { dash: null, shape: "circle" },
  oracle: { dash: "1 3", shape: "diamond" },
  other: { dash: "5 2 1 2", shape: "triangle" },
};

/** @param {string} planner */
function key(planner) {
  if (planner in STYLES) return planner;
  return planner.startsWith("oracle") ? "oracle" : "other";
}

/** The CSS that gives an element the planner's colour. @param {string} planner */
export function seriesColour(planner) {
  return `--series: var(--series-${key(planner)})`;
}

/** @param {string} planner */
export function dash(planner) {
  return STYLES[key(planner)].dash;
}

/**
 * A marker around (x, y).
 * @param {string} planner
 * @param {number} x
 * @param {number} y
 * @param {number} r
 * @param {string | null} [name] CSS class
 */
export function marker(planner, x, y, r, name = null) {
  switch (STYLES[key(planner)].shape) {
    case "circle": return svg("circle", { class: name, cx: x, cy: y, r });
    case "square": return svg("rect", { class: name, x: x - 0.88 * r, y: y - 0.88 * r, width: 1.76 * r, height: 1.76 * r });
    case "triangle": return svg("polygon", { class: name, points: `${x},${y - 1.15 * r} ${x + 1.1 * r},${y + 0.85 * r} ${x - 1.1 * r},${y + 0.85 * r}` });
    case "diamond": return svg("polygon", { class: name, points: `${x},${y - 1.25 * r} ${x + 1.25 * r},${y} ${x},${y + 1.25 * r} ${x - 1.25 * r},${y}` });
  }
}

/** The planner's line and marker, for lists. @param {string} planner */
export function swatch(planner) {
  return svg("svg", { class: "mark", viewBox: "0 0 26 12", style: seriesColour(planner), "aria-hidden": "true" },
    svg("path", { d: "M0 6H26", "stroke-dasharray": dash(planner) }), marker(planner, 13, 6, 4));
}

/**
 * The name of a solver for people.
 * @param {import("../messages.js").Catalogue | null} catalogue
 * @param {string} solver
 */
export function solverLabel(catalogue, solver) {
  return catalogue?.solvers.find(s => s.name === solver)?.label ?? solver;
}

/** A mean error for people; one that is only predicted says so, and no more than is known. @param {number} degrees @param {boolean} known */
export function errorText(degrees, known, digits = 2) {
  return known ? `${degrees.toFixed(digits)}°` : `≈${degrees.toFixed(1)}°`;
}

/**
 * The name of a planner for people.
 * @param {import("../messages.js").Catalogue | null} catalogue
 * @param {string} planner
 */
export function label(catalogue, planner) {
  const slant = planner.startsWith("ring:") ? `Ring, ${planner.slice(5)}°` : planner;
  return catalogue?.planners.find(p => p.name === planner)?.label ?? (planner === "all" ? "All lights" : slant);
}
