// The rig's worker: the link to the arm, the capture, all computing and the storage. The view only shows (rig.js).
//
// What the bytes mean, what to send and where to go is decided in the core (src/arm, src/rig); here are clock, port,
// camera frames and files.

import * as core from "../pkg/core/coil_ps.js";
import { told } from "../errors.js";
import { LEARNED, loadFull } from "../learned.js";
import { buffers, needed, optional, take } from "../wire.js";
import { now } from "./clock.js";
import { Frames, frameOf } from "./frames.js";
import { Line } from "./line.js";
import { clear, copy, holdsSession, ownFolder, read, remember, remembered, write } from "./storage.js";

/** @typedef {import("./messages.js").Calls} Calls */
/** @typedef {import("./messages.js").Kind} Kind */

/** Side of the picture to draw the mask on. */
const PREVIEW = 720;

const ready = core.default({ module_or_path: new URL("../pkg/core/coil_ps_bg.wasm", import.meta.url) });
const tell = (/** @type {import("./messages.js").Told} */ told, /** @type {Transferable[]} */ transfer = []) => self.postMessage(told, { transfer });

/** The build in use: the small one, until a learned planner is asked for. */
let lib = core;
/** @type {import("../pkg/core/coil_ps.js").Rig} */
let rig;
/** The trained planners that were loaded. @type {import("../learned.js").Models | null} */
let models = null;

/** @type {"idle" | "auto" | "one"} */
let mode = "idle";
let capturing = false;
let advancing = false;
/** @type {string | null} */
let progress = null;
/** @type {[number, number, number] | null} */
let target = null;
/** What loads while a capture is prepared; STOP, Pause and a lost port end it. @type {AbortController | null} */
let preparing = null;
/** Settings of the capture under way, to see whether others are asked for. */
let begun = "";
/** Whether what the browser keeps of the last capture is also elsewhere: in a zip or a folder of the user's. */
let saved = false;
/** A folder of the user's that the session is also saved to. @type {FileSystemDirectoryHandle | null} */
let folder = null;

/** The picture that the mask is drawn on. @type {import("../pkg/core/coil_ps.js").Frame | null} */
let frame = null;
/** @type {import("../pkg/core/coil_ps.js").MaskDrawing | null} */
let mask = null;
/** @type {number | null} */
let level = null;

let sun = { azimuth: 40, slant: 45 };
let phaseBefore = "";
let shownBefore = "";

/** What the line and the frames see of all this, as it is at that moment. @type {import("./line.js").Owner} */
const owner = {
  get rig() { return rig; },
  get lib() { return lib; },
  get idle() { return idle(); },
  show, tell, advance,
};
const line = new Line(owner);
const frames = new Frames(owner, line);

// ---- what is told ----

function show() {
  const shown = rig.shown();
  const said = rig.takeLog();
  let findings = null;
  if (shown.phase === "ready" && phaseBefore !== "ready") findings = rig.findings();
  phaseBefore = shown.phase;
  const told = { type: /** @type {const} */ ("state"), shown, said, findings, wanted: line.wanted, mode, preparing: preparing !== null, progress, target, folder: folder?.name ?? null };
  const text = JSON.stringify(told);
  if (text !== shownBefore) tell(told);
  shownBefore = text;
  return shown;
}

function tellTaken() {
  const lights = rig.lights();
  const photo = optional(lights.length ? rig.photo(lights.length - 1) : undefined);
  const [normals, relit] = [optional(rig.normals()), optional(rig.relight(sun.azimuth, sun.slant))];
  tell(
    { type: "taken", lights, photo, normals, relit, error: rig.error() ?? null, notes: rig.notes() },
    buffers([photo, normals, relit]),
  );
}

const filesOf = async (/** @type {FileSystemDirectoryHandle} */ of) => read(of, new lib.SessionFiles());

/** Where the session lies: in the chosen folder, else in the browser's own. */
const place = async () => folder && await holdsSession(folder) ? folder : ownFolder();

/** The session that can go on. */
async function storedSession() {
  try {
    const { taken, lights, simulated } = (await filesOf(await place())).summary();
    return taken < lights ? { taken, lights, simulated } : null;
  } catch {
    return null; // there is none
  }
}

/**
 * Brings the folder's session up to where the browser's copy of the same is: between the two writes of a light the
 * cable of a disk may be pulled.
 * @param {FileSystemDirectoryHandle} chosen
 */
async function bringUpToDate(chosen) {
  const [theirs, ours] = [await filesOf(chosen), await filesOf(await ownFolder())];
  if (theirs.isSame(ours) && ours.summary().taken > theirs.summary().taken) await copy(await ownFolder(), chosen);
}

/**
 * The session there, its planner at hand: that may need the other build, which then reads it.
 * @param {FileSystemDirectoryHandle} from @param {AbortSignal} signal
 */
async function opened(from, signal) {
  await learn((await filesOf(from)).summary().planner, signal);
  return filesOf(from);
}

// ---- the capture ----

/** @param {Record<string, any>} doing */
function words(doing) {
  if (doing.action === "done") return `${doing.taken} of ${doing.lights} lights. Done.`;
  const off = doing.projected ? ` (out of reach, projected by ${doing.projected.toFixed(1)}°)` : "";
  return `Light ${doing.taken + 1} of ${doing.lights}: ${doing.doing}${off}`;
}

async function advance() {
  if (advancing || !capturing || mode === "idle" || !line.opened) return;
  advancing = true;
  let before = "";
  try {
    for (;;) {
      if (idle() || !line.opened) return;
      const doing = rig.step(now());
      line.write(rig.takeOutput());
      target = doing.commanded;
      progress = words(doing);
      if (doing.doing === "moving" && before !== "moving" && frames.camera.kind === "folder") await frames.pass(frames.camera.folder);
      before = doing.doing;
      if (doing.action === "wait") {
        if (doing.until !== null) setTimeout(() => line.pump(), Math.max(doing.until - now(), 1));
        return;
      }
      show();
      if (doing.action === "expose") {
        await frames.expose(doing);
        continue;
      }
      if (doing.action === "store") {
        await save();
        rig.stored();
        tellTaken();
        if (mode !== "one") continue;
        end(`${doing.taken + 1} of ${doing.lights} lights. Paused.`, false);
        return;
      }
      if (doing.action === "done") {
        capturing = false;
        await remember(null);
        return end(progress, true);
      }
      return end(`${doing.taken} of ${doing.lights} lights are stored. ${doing.reason ?? ""}`, false);
    }
  } catch (error) {
    end("Interrupted; what was captured is stored.", false);
    tell({ type: "problem", message: /** @type {Error} */ (error).message });
  } finally {
    advancing = false;
  }
}

const idle = () => mode === "idle"; // it changes while a capture waits

/** @param {string} text @param {boolean} done */
async function end(text, done) {
  mode = "idle";
  progress = text;
  show();
  tell({ type: "ended", done, session: await storedSession() });
}

async function save() {
  saved = false;
  const files = rig.takeFiles().map(file => {
    const { name, bytes } = file;
    file.free();
    return { name, bytes };
  });
  await write(await ownFolder(), files);
  if (!folder) return;
  try {
    await write(folder, files);
  } catch (error) {
    throw withoutFolder(folder, error);
  }
}

/** @param {FileSystemDirectoryHandle} lostFolder @param {unknown} error */
function withoutFolder(lostFolder, error) {
  folder = null;
  show();
  return new Error(`The folder “${lostFolder.name}” can't be used any more (${/** @type {Error} */ (error).message}). Choose it again, or continue with what this browser has stored.`);
}

/** Lets this worker's rig plan with a network: the whole rig moves to the build that can run one. @param {string} planner @param {AbortSignal} signal */
async function learn(planner, signal) {
  if (!(planner in LEARNED)) return;
  const say = (/** @type {string} */ text) => { progress = text; show(); };
  if (!models) {
    const full = await loadFull(signal, say);
    // The rig that was stopped meanwhile stays: a new one would not know of it.
    signal.throwIfAborted();
    const drawn = mask?.pixels && { width: mask.width, height: mask.height, bytes: mask.bytes() };
    const arm = rig.armConfig();
    lib = full.lib;
    models = full.models;
    rig.free();
    frame?.free();
    frame = null;
    rig = new lib.Rig();
    rig.configureArm(arm);
    mask = drawn ? lib.MaskDrawing.of(drawn.width, drawn.height, drawn.bytes) : null;
    // The arm is asked for everything once more; its banner comes on a reset.
    if (line.opened) rig.opened(now());
  }
  await models.load(planner, signal, say);
  models.lend(rig);
}

// ---- the mask ----

function sketch() {
  if (!frame || !mask) throw new Error("take a picture first");
  const picture = take(frame.preview(PREVIEW, mask.pixels ? mask.copy() : undefined));
  const quality = mask.pixels ? frame.quality(mask) : null;
  return { picture, width: frame.width, height: frame.height, pixels: mask.pixels, level, quality };
}

/**
 * Everything before the first light: the network, the session that goes on or the place for a new one.
 * @param {import("./messages.js").CaptureSettings} settings @param {import("./messages.js").Camera} chosen
 * @param {boolean} stored @param {AbortSignal} signal
 */
async function prepare(settings, chosen, stored, signal) {
  const asked = JSON.stringify(settings);
  if (capturing && !stored && asked === begun) {
    frames.camera = chosen;
    return rig.retry();
  }
  if (!stored) await makeRoom();
  const [own, from] = [await ownFolder(), await place()];
  let files;
  if (stored) {
    if (folder && from === folder) await bringUpToDate(folder).catch(error => { throw withoutFolder(from, error); });
    files = await opened(from, signal);
  } else await learn(settings.planner, signal);
  signal.throwIfAborted();
  rig.startCapture(settings, mask?.pixels ? mask.copy() : undefined, files);
  [frames.camera, frames.shutter, begun] = [chosen, settings.shutter, asked];
  if (!stored || from === folder) await clear(own);
  if (stored && folder) await (from === folder ? copy(folder, own) : copy(own, folder));
  await remember(folder);
  await save();
  capturing = true;
  tellTaken();
}

/** Nothing that a camera took is written over unasked; simulated pictures can be had again. */
async function makeRoom() {
  if (folder && await holdsSession(folder)) {
    throw new Error(`“${folder.name}” holds a session: continue it, or choose another folder for the new one.`);
  }
  const own = await ownFolder();
  if (saved || !await holdsSession(own)) return;
  let what = "a session that can't be read";
  try {
    const { taken, lights, simulated } = (await filesOf(own)).summary();
    if (simulated || !taken) return;
    what = `a session of ${taken} of ${lights} lights`;
  } catch { /* damaged: its images may still be of use */ }
  const error = new Error(`This browser keeps ${what} that is nowhere else: continue it, download the zip, or discard it. Then begin anew.`);
  throw Object.assign(error, { name: "Unsaved" });
}

/** @type {{ [K in Kind]: (body: Calls[K]["body"]) => Promise<Calls[K]["reply"]> | Calls[K]["reply"] }} */
const answers = {
  async start({ arm, pace: given }) {
    line.pace = given;
    rig = new lib.Rig();
    let fitted = arm !== null;
    try {
      if (arm) rig.configureArm(arm);
    } catch {
      fitted = false; // of another version, or damaged: the arm is taken to stand as it is drawn
    }
    show();
    return { limits: [...rig.limits()], fitted, session: await storedSession(), folder: await remembered() };
  },

  connect({ rig: port }) {
    return line.connect(port);
  },

  disconnect() {
    mode = "idle";
    preparing?.abort();
    return line.disconnect();
  },

  stop({ sent }) {
    mode = "idle";
    preparing?.abort();
    frames.came({ shot: null, reason: "stopped" });
    line.stop(sent);
  },

  order({ order }) {
    let projected = 0;
    if (order.name === "goto") projected = rig.goto(now(), order.azimuth, order.slant);
    else if (order.name === "jog") rig.jog(now(), order.azimuth, order.slant);
    else if (order.name === "light") rig.light(now(), order.brightness);
    else if (order.name === "raw") rig.raw(now(), order.line);
    else if (order.name === "here") rig.setPosition(now(), 0, 0);
    else if (order.name === "home" || order.name === "unlock" || order.name === "release" || order.name === "reset") rig[order.name](now());
    else rig[order.name]();
    line.pump();
    return { projected };
  },

  async begin({ mode: next, settings, camera: chosen, stored }) {
    if (!line.opened) throw new Error("Connect the arm first: the simulated one needs no hardware.");
    if (preparing) throw new Error("A capture is being prepared: wait, or end that with Pause.");
    const { signal } = preparing = new AbortController();
    show();
    try {
      await prepare(settings, chosen, stored, signal);
      signal.throwIfAborted();
    } catch (error) {
      throw signal.aborted ? new Error("Ended before the first light.") : error;
    } finally {
      preparing = null;
      show();
    }
    if (!line.opened) throw new Error("The arm was disconnected meanwhile: connect it, then go on.");
    mode = next;
    line.pump();
  },

  pause() {
    preparing?.abort();
    frames.came({ shot: null, reason: "paused" });
    mode = "idle";
    progress = "Paused.";
    show();
  },

  async discard() {
    if (mode !== "idle" || preparing) throw new Error("Pause the capture first.");
    if (folder && await place() === folder) throw new Error(`The session lies in “${folder.name}”, which this page doesn't delete: choose “Not to a folder”, or another one.`);
    await clear(await ownFolder());
    await remember(null);
    capturing = false;
    progress = "The stored session was discarded.";
    rig.endCapture();
    tell({ type: "ended", done: false, session: await storedSession() });
    show();
  },

  exposed(came) {
    frames.came(came);
  },

  look({ shot, camera: from }) {
    frame?.free();
    frame = frameOf(lib, shot, from);
    if (!mask || mask.width !== frame.width || mask.height !== frame.height) {
      mask?.free();
      mask = new lib.MaskDrawing(frame.width, frame.height);
      level = null;
    }
    return sketch();
  },

  draw({ stroke }) {
    const drawn = needed(mask, "take a picture first");
    if (stroke.kind === "threshold") level = drawn.threshold(needed(frame, "take a picture first"), stroke.level ?? undefined);
    else if (stroke.kind === "polygon") drawn.polygon(new Float64Array(stroke.corners), stroke.add);
    else if (stroke.kind === "stroke") drawn.stroke(...stroke.from, ...stroke.to, stroke.radius, stroke.add);
    else {
      mask = new lib.MaskDrawing(drawn.width, drawn.height);
      drawn.free();
    }
    return sketch();
  },

  findOutline() {
    return needed(frame, "take a picture of the sphere in room light first").outline(mask?.pixels ? mask.copy() : undefined);
  },

  fitOutline({ points }) {
    return lib.fitCircle(new Float64Array(points));
  },

  measure({ outline }) {
    return needed(frame, "take a picture of the sphere under the LED first").measure(outline);
  },

  fit() {
    const [azimuth, slant, x, y, before, after, count] = rig.fitMount();
    return { mount: [azimuth, slant, x, y], before, after, count, arm: rig.armConfig() };
  },

  unfit() {
    rig.configureArm("{}");
  },

  relight(light) {
    sun = light;
    return optional(rig.relight(light.azimuth, light.slant));
  },

  async keep({ folder: chosen, settings }) {
    if (chosen && await holdsSession(chosen)) {
      if (capturing) {
        if (!(await filesOf(chosen)).isSame(await filesOf(await ownFolder()))) {
          throw new Error(`“${chosen.name}” holds another session: choose an empty folder for the one under way.`);
        }
      } else {
        await bringUpToDate(chosen);
        const files = await opened(chosen, new AbortController().signal);
        const { object, taken, lights, simulated: sim } = files.summary();
        rig.startCapture(settings, undefined, files);
        rig.takeFiles(); // nothing is written before it goes on
        folder = chosen;
        show();
        tellTaken();
        return { session: taken < lights ? { taken, lights, simulated: sim } : null, shown: { object, taken, lights } };
      }
    }
    if (chosen && capturing) await copy(await ownFolder(), chosen);
    folder = chosen;
    if (capturing) await remember(folder);
    show();
    return { session: await storedSession(), shown: null };
  },

  async zip() {
    const files = await filesOf(await place());
    saved = true;
    return /** @type {ArrayBuffer} */ (files.zip("session").buffer);
  },
};

/** @param {MessageEvent<import("./messages.js").Request>} event */
self.onmessage = async ({ data }) => {
  const { id, kind, ...body } = data;
  try {
    await ready;
    const answer = /** @type {(body: object) => any} */ (answers[kind]);
    const value = await answer(body);
    self.postMessage({ id, type: "done", value }, { transfer: buffers(value) });
  } catch (error) {
    self.postMessage({ id, type: "failed", error: told(error) });
  }
};
