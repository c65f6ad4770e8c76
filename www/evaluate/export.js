// What can be saved. The bytes are made in the worker.

import { download } from "../svg.js";

/** @typedef {import("../main.js").Page} Page */
/** @typedef {import("./evaluate.js").State} State */
/** @typedef {import("../messages.js").Calls["export"]["body"]["what"]} What */

/** @typedef {import("../store.js").Store<State>} Store */
/** @typedef {{ name: string, ready: (state: Readonly<State>) => boolean, save: (page: Page, store: Store) => Promise<void> }} Export */

/** Files that are the same whatever solves them. @type {What[]} */
const UNSOLVED = ["lp", "image"];

/** @type {Export[]} */
export const EXPORTS = [
  { name: "Table (CSV)", ready: state => state.report !== null, save: async (_, { state }) => download(new Blob([csv(state)], { type: "text/csv" }), `${base(state)}.csv`) },
  { name: "Table (JSON, as coil eval writes it)", ready: state => state.report !== null, save: async (_, { state }) => download(new Blob([JSON.stringify(state.report, null, 2)], { type: "application/json" }), `${base(state)}.json`) },
  { name: "Object (DiLiGenT, .zip)", ready: state => state.object !== null, save: (page, store) => saveFromWorker(page, store, "object") },
  shown("Lights of this run (.lp)", "lp"),
  shown("Normals (16-bit PNG)", "normals"),
  shown("Error map (PNG)", "errors"),
  shown("Predicted error map (PNG)", "expected"),
  shown("Picture (PNG)", "image"),
  shown("Surface (glTF)", "glb"),
  shown("Surface (OBJ)", "obj"),
  shown("Surface (PLY)", "ply"),
  shown("Relit picture (PNG)", "relit"),
];

/**
 * @param {string} name
 * @param {What} what
 * @returns {Export}
 */
function shown(name, what) {
  return { name, ready: state => canSave(state, what), save: (page, store) => saveFromWorker(page, store, what) };
}

/**
 * Whether this file of the step that is shown is there, and complete.
 * @param {Readonly<State>} state
 * @param {What} what
 */
export function canSave(state, what) {
  const { view, relit } = state;
  if (!view || !isCurrent(state)) return false;
  if (UNSOLVED.includes(what)) return true;
  const made = what === "errors" ? view.errors : what === "expected" ? view.expected : what === "relit" ? relit : view.normals;
  return Boolean(made) && view.solved === 1;
}

/** Why a file can't be saved yet; empty where it is no matter of time. @param {Readonly<State>} state */
export function waiting(state) {
  if (!state.view) return "";
  if (!isCurrent(state)) return "The step that was chosen is being solved: its files can be saved when it is shown.";
  if (state.view.solved < 1) return `${(100 * state.view.solved).toFixed(0)} % solved: the maps can be saved when all of it is.`;
  return "";
}

/** Whether the maps are those of the step that was chosen, not of the one before. @param {Readonly<State>} state */
function isCurrent({ view, shown }) {
  return view?.of === shown;
}

/**
 * @param {Page} page
 * @param {Store} store
 * @param {What} what
 */
export async function saveFromWorker(page, store, what) {
  const { state } = store;
  const { bytes, type, name } = await page.engine.call("export", { what }).finally(() => {
    const same = what === "object" ? store.state.object === state.object : store.state.view === state.view;
    if (!same) throw new Error("something else is shown by now: save it once more");
  });
  const { planner = "", step = 0, solver = "" } = state.view?.of ?? {};
  const made = what === "object" ? [] : [planner, step, ...(UNSOLVED.includes(what) ? [] : [solver])];
  download(new Blob([bytes], { type }), fileName(state, ...made, name));
}

/**
 * Saves what a canvas shows of a step.
 * @param {Store} store
 * @param {HTMLCanvasElement} canvas
 * @param {string} name
 */
export async function saveCanvas({ state }, canvas, name) {
  const { planner = "", step = 0 } = state.view?.of ?? {};
  /** @type {Blob | null} */
  const blob = await new Promise(resolve => canvas.toBlob(resolve));
  if (!blob) throw new Error("the browser could not write it");
  download(blob, fileName(state, planner, step, name));
}

/** @param {Readonly<State>} state @param {(string | number)[]} parts */
function fileName(state, ...parts) {
  return [base(state), ...parts].join("-").replaceAll(":", "_");
}

/** @param {Readonly<State>} state */
function base({ object }) {
  return (object?.name ?? "object").replace(/[^\w.-]+/g, "_");
}

/** The report's rows with the columns of `coil eval --json`. @param {Readonly<State>} state */
function csv({ report }) {
  const columns = /** @type {const} */ (["object", "bits", "protocol", "lookup", "planner", "oracle", "solver", "lights", "lights_taken", "draws", "seed", "mae", "ci95_low", "ci95_high", "mae_as_published", "predicted_mae", "effective_images", "deviation", "error"]);
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
