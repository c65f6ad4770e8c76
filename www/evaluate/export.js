// What can be saved. The bytes are made in the worker.

import { download } from "../svg.js";

/** @typedef {import("../main.js").Page} Page */
/** @typedef {import("./evaluate.js").State} State */
/** @typedef {import("../messages.js").Calls["export"]["body"]["what"]} What */

/** @typedef {{ name: string, ready: (state: Readonly<State>) => boolean, save: (page: Page, state: Readonly<State>) => Promise<void> }} Export */

const solved = (/** @type {Readonly<State>} */ state) => Boolean(state.view?.normals);

/** @type {Export[]} */
export const EXPORTS = [
  { name: "Table (CSV)", ready: state => state.report !== null, save: async (_, state) => download(new Blob([csv(state)], { type: "text/csv" }), `${base(state)}.csv`) },
  { name: "Table (JSON, as coil eval writes it)", ready: state => state.report !== null, save: async (_, state) => download(new Blob([JSON.stringify(state.report, null, 2)], { type: "application/json" }), `${base(state)}.json`) },
  { name: "Object (DiLiGenT, .zip)", ready: state => state.object !== null, save: (page, state) => saveFromWorker(page, state, "object") },
  { name: "Lights of this run (.lp)", ready: state => state.view !== null, save: (page, state) => saveFromWorker(page, state, "lp") },
  { name: "Normals (16-bit PNG)", ready: solved, save: (page, state) => saveFromWorker(page, state, "normals") },
  { name: "Error map (PNG)", ready: state => Boolean(state.view?.errors), save: (page, state) => saveFromWorker(page, state, "errors") },
  { name: "Predicted error map (PNG)", ready: state => Boolean(state.view?.expected), save: (page, state) => saveFromWorker(page, state, "expected") },
  { name: "Picture (PNG)", ready: state => state.view !== null, save: (page, state) => saveFromWorker(page, state, "image") },
  { name: "Surface (glTF)", ready: solved, save: (page, state) => saveFromWorker(page, state, "glb") },
  { name: "Surface (OBJ)", ready: solved, save: (page, state) => saveFromWorker(page, state, "obj") },
  { name: "Surface (PLY)", ready: solved, save: (page, state) => saveFromWorker(page, state, "ply") },
  { name: "Relit picture (PNG)", ready: state => state.relit !== null, save: (page, state) => saveFromWorker(page, state, "relit") },
];

/**
 * @param {Page} page
 * @param {Readonly<State>} state
 * @param {What} what
 */
async function saveFromWorker(page, state, what) {
  const { bytes, type, name } = await page.engine.call("export", { what });
  download(new Blob([bytes], { type }), `${base(state)}-${what === "object" ? "" : `${state.shown.planner}-${state.shown.step}-`}${name}`);
}

/**
 * The picture of a map.
 * @param {Page} page
 * @param {Readonly<State>} state
 * @param {"image" | "normals" | "errors" | "expected" | "relit" | "surface"} what
 */
export function savePicture(page, state, what) {
  return saveFromWorker(page, state, what);
}

/** @param {Readonly<State>} state */
function base({ object }) {
  return (object?.name ?? "object").replace(/[^\w.-]+/g, "_");
}

/** The report's rows with the columns of `coil eval --json`. @param {Readonly<State>} state */
function csv({ report }) {
  const columns = /** @type {const} */ (["object", "bits", "protocol", "lookup", "planner", "oracle", "solver", "lights", "lights_taken", "draws", "seed", "mae", "ci95_low", "ci95_high", "mae_as_published", "effective_images", "deviation", "error"]);
  const cell = (/** @type {unknown} */ value) => {
    const text = value === null || value === undefined ? "" : String(value);
    return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const lines = (report?.results ?? []).map(row => {
    /** @type {Record<string, unknown>} */
    const flat = { ...row, ci95_low: row.ci95?.[0], ci95_high: row.ci95?.[1] };
    return columns.map(name => cell(flat[name])).join(",");
  });
  return [columns.join(","), ...lines, ""].join("\n");
}
