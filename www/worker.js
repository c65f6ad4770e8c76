// The worker that computes everything: it owns the object, its stack and what is shown of it. Requests are answered
// as they come; a run pauses between its slices, so that others are answered meanwhile, and an abort is heard.

import * as core from "./pkg/core/coil_ps.js";
import { told } from "./errors.js";
import { Helpers } from "./helpers.js";
import { readObject } from "./reader.js";
import { LEARNED, learnedPlanners, loadFull } from "./learned.js";
import { IN_PIECES } from "./solvers.js";
import { buffers, needed, optional, take } from "./wire.js";

/** @typedef {import("./messages.js").Calls} Calls */
/** @typedef {import("./messages.js").Kind} Kind */
/** @typedef {import("./messages.js").Direction} Direction */
/** @typedef {import("./pkg/core/coil_ps.js").Picture} CorePicture */

/** Pixels of the small pictures along a run. */
const THUMBNAIL = 104;

/** Steps of the surface higher than this, in pixels, are breaks. */
const CLIFF = 6;
/** Width of rendered objects, pixels. */
const RENDERED = 160;
/** Families of one sculpture only. */
const UNSEEDED = ["sphere", "bowl"];
/** A computation that can be cut pauses so often. */
const SLICE_MS = 30;

/** Compiled once; helpers get it by message. */
const compiled = WebAssembly.compileStreaming(fetch(new URL("pkg/core/coil_ps_bg.wasm", import.meta.url)));
const ready = compiled.then(module => core.default({ module_or_path: module }));
const helpers = new Helpers(compiled);

/** The build in use: the small one, until a learned planner is asked for. Objects of one are of no use to the other. */
let lib = core;
/** The trained planners that were loaded. @type {import("./learned.js").Models | null} */
let models = null;

const state = {
  /** @type {import("./pkg/core/coil_ps.js").CapturedObject | null} */
  object: null,
  /** @type {import("./pkg/core/coil_ps.js").Stack | null} */
  stack: null,
  protocol: "official",
  /** @type {{ observations: import("./pkg/core/coil_ps.js").Observations, solution: import("./pkg/core/coil_ps.js").Solution | null, surface: import("./pkg/core/coil_ps.js").Surface | null, scale: number } | null} */
  shown: null,
  /** @type {import("./pkg/core/coil_ps.js").Relit | null} */
  relit: null,
  /** @type {Direction} */
  sun: [0, 0, 1],
  turn: { yaw: 0, tilt: 0 },
};

/**
 * What a request can do besides answering.
 * @template {Kind} K
 * @typedef {{ signal: AbortSignal, progress: (value: Calls[K]["progress"], transfer?: Transferable[]) => void }} Context
 */

/** @type {{ [K in Kind]: (body: Calls[K]["body"], context: Context<K>) => Promise<Calls[K]["reply"]> | Calls[K]["reply"] }} */
const answers = {
  async catalogue() {
    const pair = (/** @type {string} */ line) => /** @type {[string, string]} */ (line.split(": "));
    const all = lib.catalogue();
    const { names, withheld } = await learnedPlanners();
    const planners = all.planners.filter(({ name }) => names.includes(name) || !(name in LEARNED));
    return { ...all, planners, withheld, families: lib.families().map(pair), materials: lib.materials() };
  },

  async open({ source }, { signal, progress }) {
    const start = performance.now();
    const opened = source.kind === "files"
      ? await readObject(lib, source.files, source.object, helpers, signal, progress)
      : { object: await photograph(source, signal, progress), notes: [], objects: [] };
    signal.throwIfAborted();
    const { object, notes, objects } = opened;
    forget();
    state.object?.free();
    state.object = object;
    const { name, bits, images, width, height, pixels, truth } = object;
    return { name, bits, images, width, height, pixels, truth, notes, objects, seconds: (performance.now() - start) / 1000 };
  },

  prepare({ protocol }) {
    const stack = needed(state.object, "open an object first").prepare(protocol);
    forget();
    state.stack = stack;
    state.protocol = protocol;
    const { width, height, pixels, truth, reach } = stack;
    const flat = stack.lights();
    const lights = Array.from({ length: flat.length / 3 }, (_, i) => /** @type {Direction} */ ([...flat.subarray(3 * i, 3 * i + 3)]));
    return { protocol, width, height, pixels, truth, reach, lights, names: stack.names() };
  },

  // Learned planners come last: what they need is large, and the others need not wait for it.
  async run({ settings }, { signal, progress }) {
    needed(state.stack, "open an object first");
    const learned = settings.planners.filter(name => name in LEARNED);
    const plain = settings.planners.filter(name => !(name in LEARNED));
    const whole = settings.planners.length;
    // What can't be fetched takes its own rows with it, and no others.
    const slow = settings.solvers.filter(name => IN_PIECES.includes(name));
    const unsolved = slow.length ? await failure(helpers.network(), signal) : null;
    const solvers = settings.solvers.filter(name => !unsolved || !slow.includes(name));
    if (unsolved && !solvers.length) throw new Error(unsolved);
    /** @type {import("./messages.js").Report | null} */
    let report = null;
    if (plain.length) report = await compare({ ...settings, solvers, planners: plain }, 0, whole, signal, progress);
    if (learned.length) {
      const say = (/** @type {string} */ what) => progress({ done: plain.length, total: whole, what, step: null, row: [] });
      const unplanned = await failure(learn(learned, signal, say), signal);
      const late = await compare({ ...settings, solvers, planners: learned }, plain.length, whole, signal, progress);
      const rows = late.results.map(row => row.error && unplanned ? { ...row, error: unplanned } : row);
      report = { ...late, results: [...(report?.results ?? []), ...rows] };
    }
    const { results, ...rest } = needed(report, "no planner was chosen");
    return { ...rest, settings, results: unsolved ? results.flatMap(row => withFailed(row, solvers, slow, unsolved)) : results };
  },

  // A run is nothing but the directions it asked for: its pictures can be had again at any step.
  async view({ asked, lookup, solver, scale }, { signal, progress }) {
    const stack = needed(state.stack, "open an object first");
    const observations = stack.observe(new Float32Array(asked.flat()), lookup);
    const quick = IN_PIECES.includes(solver) ? "ls" : solver;
    let solution = null;
    try {
      if (asked.length >= 3) solution = observations.solve(quick);
    } catch (error) {
      // The first lights may lie in one plane: there are no normals yet.
      if (asked.length >= 5) throw error;
    }
    if (quick === solver || !solution) return show(observations, solution, scale, 1);
    solution.free();
    const tiles = observations.tiles(solver);
    let shown = false;
    const showTiles = () => {
      shown = true;
      return show(observations, tiles.solution(), scale, tiles.done / tiles.total);
    };
    try {
      const onLevel = () => {
        const preview = showTiles();
        progress(preview, buffers(preview));
      };
      await helpers.solve(tiles, { signal, urgent: true, onLevel });
      return showTiles();
    } finally {
      tiles.free();
      if (!shown) observations.free();
    }
  },

  /** Mean errors of solvers that take seconds on these pictures, when nothing else is to be solved; without truth what they expect. */
  async score({ asked, lookup, solvers }, { signal }) {
    const observations = needed(state.stack, "open an object first").observe(new Float32Array(asked.flat()), lookup);
    const tiles = observations.tiles(solvers[0]);
    observations.free();
    try {
      await helpers.solve(tiles, { signal, urgent: false });
      return solvers.map(name => {
        const solution = tiles.solution(name);
        const error = meanError(solution);
        solution.free();
        return error;
      });
    } finally {
      tiles.free();
    }
  },

  insight({ planner, lights }) {
    const observations = state.shown?.observations;
    const insight = observations && models?.insight(planner, observations, lights);
    if (!insight) return null;
    /** @type {number[]} */
    const milliseconds = [];
    /** @type {ArrayLike<number>} */
    let next = [0, 0, 1];
    for (let i = 0; i < observations.count; i += 1) {
      const start = performance.now();
      next = insight.observe(observations, i);
      milliseconds.push(performance.now() - start);
    }
    const gate = optional(insight.gatePicture(observations));
    insight.free();
    return { gate, next: [next[0], next[1], next[2]], milliseconds };
  },

  relight({ light }) {
    state.sun = light;
    return optional(state.relit?.under(new Float32Array(light))); // a newer view may have no normals
  },

  async surface({ yaw, tilt, size }, { signal }) {
    state.turn = { yaw, tilt };
    return state.shown?.solution ? take((await surface(signal)).picture(yaw, tilt, size)) : null;
  },

  photo({ index, size }) {
    return take(needed(state.stack, "open an object first").photo(index, size));
  },

  pixel({ x, y }) {
    const values = x < 0 || y < 0 ? undefined : state.shown?.solution?.pixel(x, y);
    if (!values) return null;
    const [column, row, nx, ny, nz, expected, error = null] = values;
    return { x: column, y: row, normal: [nx, ny, nz], error, expected };
  },

  colours({ width }) {
    return take(lib.colourBar(width));
  },

  async export({ what }, { signal }) {
    if (what === "object") {
      const object = needed(state.object, "open an object first");
      return file(object.toZip(), "application/zip", "diligent.zip");
    }
    const { observations, solution, scale } = needed(state.shown, "nothing is shown yet");
    const solved = () => needed(solution, "there are no normals yet");
    switch (what) {
      case "lp": return file(new TextEncoder().encode(observations.lightList()), "text/plain", "lights.lp");
      case "normals": return file(solved().normalsPng(), "image/png", "normals.png");
      case "errors": return file(needed(solved().errorPng(scale), "the true normals are not known"), "image/png", `error-0-${scale}deg.png`);
      case "expected": return png(needed(solved().uncertaintyPicture(scale), "the solver does not say how sure it is"), `predicted-error-0-${scale}deg.png`);
      case "surface": return png((await surface(signal)).picture(state.turn.yaw, state.turn.tilt, 1024), "surface.png");
      case "image": return png(observations.photo(observations.count - 1, 4096), "picture.png");
      case "glb": return file((await surface(signal)).write("glb"), "model/gltf-binary", "surface.glb");
      case "obj": return file((await surface(signal)).write("obj"), "model/obj", "surface.obj");
      case "ply": return file((await surface(signal)).write("ply"), "application/octet-stream", "surface.ply");
      case "relit": return png(needed(state.relit, "there are no normals yet").under(new Float32Array(state.sun)), "relit.png");
    }
  },
};

/**
 * What to say where something could not be fetched; null where it was.
 * @param {Promise<unknown>} fetching
 * @param {AbortSignal} signal
 */
async function failure(fetching, signal) {
  try {
    await fetching;
    return null;
  } catch (error) {
    signal.throwIfAborted();
    return `${told(error).message}. Check the connection, then press Run again`;
  }
}

/** The mean error, or without truth the one that is predicted. @param {import("./pkg/core/coil_ps.js").Solution} solution */
function meanError({ mae, expectedError }) {
  return mae ?? expectedError ?? null;
}

/**
 * A row, and after a planner's last one a row of each solver that is not there.
 * @param {import("./messages.js").ResultRow} row
 * @param {string[]} solvers that are
 * @param {string[]} missing
 * @param {string} error
 */
function withFailed(row, solvers, missing, error) {
  if (row.solver !== solvers.at(-1)) return [row];
  return [row, ...missing.map(solver => ({ ...row, solver, mae: null, ci95: null, mae_as_published: null, maes: [], predicted_mae: undefined, error }))];
}

/**
 * Renders an object under a stage of lights.
 * @param {Exclude<import("./messages.js").Source, { kind: "files" }>} source
 * @param {AbortSignal} signal
 * @param {(progress: { done: number, total: number, what: string }) => void} progress
 */
async function photograph(source, signal, progress) {
  progress({ done: 0, total: 1, what: "preparing the shape" });
  const capture = source.kind === "mesh"
    ? lib.Capture.mesh(source.file.name, new Uint8Array(await source.file.arrayBuffer()), source.material, RENDERED)
    : lib.Capture.sculpture(UNSEEDED.includes(source.family) ? source.family : `${source.family}:${source.seed}`, source.material, RENDERED);
  let next = performance.now();
  while (capture.done < capture.total) {
    capture.takeNext();
    if (performance.now() < next) continue;
    progress({ done: capture.done, total: capture.total, what: "rendering image" });
    await pause();
    if (signal.aborted) capture.free();
    signal.throwIfAborted();
    next = performance.now() + SLICE_MS;
  }
  return capture.finish();
}

/**
 * Runs planners that are there; progress counts planners, beginning at `before`.
 * @param {import("./messages.js").Settings} settings
 * @param {number} before
 * @param {number} whole
 * @param {AbortSignal} signal
 * @param {Context<"run">["progress"]} progress
 */
async function compare(settings, before, whole, signal, progress) {
  const evaluation = new lib.Evaluation(needed(state.stack, "open an object first"), settings);
  try {
    models?.lend(evaluation);
    const total = evaluation.total;
    const at = (/** @type {number} */ runs) => ({ done: before + settings.planners.length * runs / total, total: whole });
    if (settings.stop_at && IN_PIECES.includes(settings.solvers[0])) lib.loadPixelNetwork(await helpers.network());
    let rows = 0;
    let last = "";
    for (let done = 0; done < total; done += 1) {
      const planner = evaluation.nextPlanner ?? "";
      let steps = 0;
      evaluation.runNext(THUMBNAIL, (step, found, small) => {
        const thumbnail = take(small);
        steps += 1;
        const errors = Object.fromEntries(settings.solvers.map((name, i) => [name, found[i]]));
        progress({ ...at(done), step: { name: planner, step, errors, thumbnail }, row: [] }, [thumbnail.data]);
      });
      const tiles = evaluation.tiles();
      if (tiles) {
        try {
          await helpers.solve(tiles, { signal, urgent: false, onPiece: part => progress({ ...at(done + part), step: null, row: [] }) });
          for (const solver of settings.solvers.filter(name => IN_PIECES.includes(name))) {
            const solution = tiles.solution(solver);
            const error = meanError(solution);
            evaluation.settle(solver, solution);
            solution.free();
            if (planner !== last) progress({ ...at(done), step: null, late: { name: planner, steps, solver, error }, row: [] });
          }
        } finally {
          tiles.free();
        }
      }
      last = planner;
      // A planner's rows are complete when the next one begins.
      const complete = evaluation.nextPlanner !== planner ? evaluation.report().results.slice(rows) : [];
      rows += complete.length;
      progress({ ...at(done + 1), step: null, row: complete });
      await pause();
      signal.throwIfAborted();
    }
    return evaluation.report();
  } finally {
    evaluation.free();
    void helpers.start(); // idle now, and ready when someone opens a folder
  }
}

/**
 * Makes sure that trained planners are there: the build that can run them, with the object in it, and their files.
 * @param {string[]} planners
 * @param {AbortSignal} signal
 * @param {(what: string) => void} progress
 */
async function learn(planners, signal, progress) {
  if (!models) {
    const loaded = await loadFull(signal, progress);
    const object = state.object && loaded.adopt(state.object);
    forget();
    state.object?.free();
    state.object = object;
    lib = loaded.lib;
    models = loaded.models;
    state.stack = object?.prepare(state.protocol) ?? null;
  }
  for (const name of planners) await models.load(name, signal, progress);
}

/** The surface of what is shown, integrated when it is first asked for. @param {AbortSignal} signal */
async function surface(signal) {
  const shown = needed(state.shown, "nothing is shown yet");
  if (shown.surface) return shown.surface;
  const solution = needed(shown.solution, "there are no normals yet");
  const stack = needed(state.stack, "open an object first");
  const { width, height } = stack;
  const heights = await helpers.integrate({ mask: stack.mask(), width, height, normals: solution.normals() }, signal);
  if (state.shown !== shown) throw new DOMException("another step is shown now", "AbortError");
  shown.surface ??= solution.surface(heights, CLIFF);
  return shown.surface;
}

/**
 * Makes pictures of a step the ones that are shown.
 * @param {import("./pkg/core/coil_ps.js").Observations} observations
 * @param {import("./pkg/core/coil_ps.js").Solution | null} solution
 * @param {number} scale
 * @param {number} solved part of the pixels that the solution is made of
 */
function show(observations, solution, scale, solved) {
  if (state.shown?.observations === observations) releaseSolution();
  else release();
  state.shown = { observations, solution, scale, surface: null };
  state.relit = solution?.relit() ?? null;
  return {
    image: take(observations.photo(observations.count - 1, 4096)),
    normals: solution && take(solution.normalsPicture()),
    errors: optional(solution?.errorPicture(scale)),
    expected: optional(solution?.uncertaintyPicture(scale)),
    expectedMean: solution?.expectedError ?? null,
    lampDistance: solution?.lampDistance ?? null,
    mae: solution?.mae ?? null,
    unknown: solution?.unknown ?? 0,
    invalid: solution?.invalid ?? 0,
    solved,
  };
}

/** Frees what was solved of what is shown. */
function releaseSolution() {
  state.shown?.solution?.free();
  state.shown?.surface?.free();
  state.relit?.free();
  state.relit = null;
}

/** Frees what is shown. */
function release() {
  releaseSolution();
  state.shown?.observations.free();
  state.shown = null;
}

/** Frees the stack and all that rests on it. */
function forget() {
  release();
  state.stack?.free();
  state.stack = null;
}

/**
 * @param {Uint8Array} bytes
 * @param {string} type
 * @param {string} name
 */
function file(bytes, type, name) {
  return { bytes: /** @type {ArrayBuffer} */ (bytes.buffer), type, name };
}

/**
 * @param {CorePicture} picture
 * @param {string} name
 */
async function png(picture, name) {
  const { width, height, data } = take(picture);
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d")?.putImageData(new ImageData(new Uint8ClampedArray(data), width, height), 0, 0);
  const blob = await canvas.convertToBlob({ type: "image/png" });
  return { bytes: await blob.arrayBuffer(), type: "image/png", name };
}

const { port1: bell, port2: ear } = new MessageChannel();

/** Lets the messages that wait be handled. @returns {Promise<void>} */
function pause() {
  return new Promise(resolve => {
    ear.onmessage = () => resolve();
    bell.postMessage(null);
  });
}

/** @type {Map<number, AbortController>} */
const underWay = new Map();

/** @param {MessageEvent<import("./messages.js").Request | import("./messages.js").Abort>} event */
self.onmessage = async ({ data }) => {
  if (data.kind === "abort") return underWay.get(data.id)?.abort();
  const { id, kind, ...body } = data;
  const controller = new AbortController();
  underWay.set(id, controller);
  try {
    await ready;
    controller.signal.throwIfAborted();
    const progress = (/** @type {unknown} */ value, /** @type {Transferable[]} */ transfer = []) =>
      self.postMessage({ id, type: "progress", value }, { transfer });
    // The body is that of the kind: `Request` says so, but TypeScript does not follow the destructuring.
    const answer = /** @type {(body: object, context: object) => unknown} */ (answers[kind]);
    const value = await answer(body, { signal: controller.signal, progress });
    self.postMessage({ id, type: "done", value }, { transfer: buffers(value) });
  } catch (error) {
    self.postMessage({ id, type: "failed", error: told(error) });
  } finally {
    underWay.delete(id);
  }
};
