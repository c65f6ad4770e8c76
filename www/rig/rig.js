// The rig view: an arm on a serial port (or the simulated one), its position, and a capture that drives it. All of it
// is computed in the rig's worker (worker.js); here it is shown and asked for. Only here can be: the choice of a port,
// webcams, files, and Stop, which waits for no worker.

import { download, draw, find, html, set } from "../svg.js";
import { Webcam, chooseFolder, chooseImages, explainCamera } from "./camera.js";
import { Client } from "./client.js";
import { Host } from "./host.js";
import { MaskPanel } from "./mask.js";
import { Plot } from "./plot.js";
import { explain, portName, serial, unsupported } from "./port.js";
import { TEMPLATE } from "./template.js";

const LOG_LINES = 500;
/** How the simulated arm stands when it stands askew: azimuth, slant, tilt about x and y; degrees. */
const ASKEW = /** @type {[number, number, number, number]} */ ([4, -2, 1.5, -1]);
const ARM_KEY = "coil-ps.arm";
const MARKS = /** @type {Record<string, string>} */ ({ sent: ">", received: "<", note: "#", failed: "!" });

/** How many times as fast as a real one the simulated arm is: `?pace=4` in the page's address. */
function pace() {
  const given = Number(new URLSearchParams(location.search).get("pace"));
  return given >= 1 && given <= 20 ? given : 1;
}

/**
 * @param {HTMLElement} root
 * @param {import("../main.js").Page} page
 */
export async function mount(root, page) {
  if (!document.querySelector("link[href$='rig/rig.css']")) {
    document.head.append(html("link", { rel: "stylesheet", href: new URL("rig.css", import.meta.url).href }));
  }
  root.classList.add("rig");
  root.innerHTML = TEMPLATE;

  const $ = (/** @type {string} */ selector) => find(root, selector, HTMLElement);
  const input = (/** @type {string} */ selector) => find(root, selector, HTMLInputElement);
  const number = (/** @type {string} */ selector) => input(selector).valueAsNumber;
  /** A number within its field's limits. @param {string} selector @param {string} name @param {boolean} [whole] */
  function typed(selector, name, whole = false) {
    const { valueAsNumber: value, min, max } = input(selector);
    if (value >= Number(min) && value <= Number(max) && (!whole || Number.isInteger(value))) return value;
    throw new Error(`${name}: a ${whole ? "whole " : ""}number from ${min} to ${max} is needed.`);
  }
  const select = (/** @type {string} */ selector) => find(root, selector, HTMLSelectElement);
  const button = (/** @type {string} */ selector) => find(root, selector, HTMLButtonElement);
  const canvas = (/** @type {string} */ selector) => find(root, selector, HTMLCanvasElement);
  const on = (/** @type {string} */ selector, /** @type {() => unknown} */ work) => $(selector).addEventListener("click", work);

  const say = (/** @type {string} */ text) => { $(".rig-said").textContent = text; };
  const failed = (/** @type {unknown} */ error) => say(/** @type {Error} */ (error).message);

  const client = new Client(heard, error => page.problem("The rig's worker has failed", error, "Reload the page; the session is stored."));
  const webcam = new Webcam();
  $(".rig-video").append(webcam.video);
  const mask = new MaskPanel(client, failed);
  $(".rig-real").append(mask.element);
  /** @type {Plot | null} */
  let plot = null;

  /** Another thread's, or this one's: what holds the serial port. @type {{ stop: () => void, close: () => void } | null} */
  let host = null;
  /** @type {Worker | null} */
  let portWorker = null;
  /** @type {any[]} */
  let remembered = [];
  /** @type {import("./messages.js").State | null} */
  let state = null;
  /** @type {import("./messages.js").LightTaken[]} */
  let lights = [];
  /** The folder that is watched. @type {FileSystemDirectoryHandle | null} */
  let watched = null;
  /** Files that were chosen and wait for their exposure. @type {File[]} */
  let given = [];
  let gave = () => {};
  /** @type {import("./messages.js").Stored | null} */
  let stored = null;
  /** The session's folder before the reload: the browser asks on a click whether it may be used again. @type {FileSystemDirectoryHandle | null} */
  let former = null;
  /** @type {string[]} */
  const log = [];

  // ---- what the worker tells ----

  /** @param {import("./messages.js").Told} told */
  function heard(told) {
    switch (told.type) {
      case "state": return showState(told);
      case "taken": return showTaken(told);
      case "expose": return void expose(told);
      case "help": return help(told.text);
      case "problem": return page.problem("The capture can't go on", new Error(told.message), "What was captured is stored; continue when the cause is mended.");
      case "ended":
        $(".rig-ask").hidden = true;
        offer(told.session);
        if (told.done) page.announce("The capture is done");
    }
  }

  /** @param {import("./messages.js").Said} said */
  function addLog({ kind, text }) {
    const line = `${new Date().toISOString().slice(11, 23)} ${MARKS[kind]} ${text}`;
    log.push(line);
    const lines = $(".rig-lines");
    const atEnd = lines.scrollTop + lines.clientHeight >= lines.scrollHeight - 30;
    lines.append(html("div", { class: kind }, line));
    while (log.length > LOG_LINES) {
      log.shift();
      lines.firstElementChild?.remove();
    }
    if (atEnd) lines.scrollTop = lines.scrollHeight;
    if (kind === "failed") say(text);
  }

  /** @param {import("./messages.js").State} told */
  function showState(told) {
    const before = state?.shown.phase;
    state = told;
    told.said.forEach(addLog);
    const { shown: s, wanted, mode } = told;
    const words = /** @type {Record<string, string>} */ ({
      closed: s.reason ? `Disconnected: ${s.reason}` : "Not connected",
      opening: "Port open, waiting for the firmware…",
      reading: `Grbl ${s.version} found, reading its settings…`,
      ready: `Connected: Grbl ${s.version}`,
      stopped: s.confirmed ? "Stopped. Release Stop, then home." : "Stopping…",
    })[s.phase];
    const text = (/** @type {string} */ selector, /** @type {string} */ value) => {
      if ($(selector).textContent !== value) $(selector).textContent = value;
    };
    text(".rig-state", wanted && s.phase === "closed" ? "Trying to reconnect…" : words);
    set(root, { "data-phase": s.phase });
    text(".rd-state", s.phase === "closed" ? "–" : s.state ?? "not known");
    text(".rd-azimuth", s.azimuth === null ? "–" : `${s.azimuth.toFixed(2)}°`);
    text(".rd-slant", s.slant === null ? "–" : `${s.slant.toFixed(2)}°`);
    text(".rd-trust", s.phase === "closed" ? "–" : { homed: "known, homed", assumed: "counted from where it was switched on", lost: "lost: home the arm" }[/** @type {"homed"} */ (s.trust)]);
    // Never beside an arm that can home: pressed by mistake it would move the zero of its scale for good.
    $("[data-do=here]").hidden = s.phase !== "ready" || s.homes;
    text(".rd-led", s.led === null ? "–" : s.led ? `S${s.led}` : "off");
    text(".rig-folder", told.folder === null ? "Save to a folder…" : `Also saved to “${told.folder}”`);
    $(".rig-no-folder").hidden = told.folder === null;
    text(".rig-connect", wanted || s.phase !== "closed" ? "Disconnect" : "Connect");
    if (told.findings) {
      $(".rig-findings").replaceChildren(...told.findings.map(f => html("li", { class: f.kind === "error" ? "rig-bad" : "note" }, f.text)));
      if (before === "reading") page.announce("The arm is connected");
    }
    if (s.phase === "stopped" && before !== "stopped") page.announce("Stopped");
    if (told.progress !== null) text(".rig-progress", told.progress);
    const busy = mode !== "idle" || told.preparing;
    button(".rig-pause").disabled = !busy;
    button(".rig-auto").disabled = button(".rig-next").disabled = busy;
    if (busy) $(".rig-continue").hidden = $(".rig-discard").hidden = true;
    plot?.update({ light: s.direction, target: told.target, done: lights });
  }

  /** @param {import("./messages.js").Taken} told */
  function showTaken(told) {
    ({ lights } = told);
    for (const [selector, picture] of /** @type {const} */ ([[".rig-photo", told.photo], [".rig-normals", told.normals], [".rig-relit", told.relit]])) {
      if (picture) draw(canvas(selector), picture);
    }
    $(".rig-error").textContent = !told.normals ? "Normals (from 3 lights)" : told.error === null ? "Normals" : `Normals, error ${told.error.toFixed(2)}°`;
    const percent = (/** @type {number} */ v) => `${(100 * v).toFixed(1)} %`;
    const measured = lights.some(l => l.measured);
    const head = ["Light", "Reached", ...measured ? ["Measured"] : [], "Saturated", "Dark", "Noise", "Move"];
    const rows = lights.map((l, i) => [
      String(i + 1),
      l.projected ? `${l.projected.toFixed(1)}° off` : "exact",
      ...measured ? [l.off === null ? "not seen" : `${l.off.toFixed(1)}° off ±${(l.uncertainty ?? 0).toFixed(1)}°`] : [],
      percent(l.saturated), percent(l.dark), percent(l.noise), `${l.move.toFixed(2)} s`,
    ]);
    $(".rig-table").replaceChildren(html("table", {},
      html("thead", {}, html("tr", {}, ...head.map(t => html("th", { scope: "col" }, t)))),
      html("tbody", {}, ...rows.map(row => html("tr", {}, ...row.map(t => html("td", {}, t)))))));
    $(".rig-fit").hidden = !measured && !localStorage.getItem(ARM_KEY);
    $(".rig-notes").replaceChildren(...told.notes.slice(-6).map(note => html("li", {}, note)));
    const mean = (/** @type {"plan" | "move" | "settle" | "expose" | "merge" | "solve"} */ key) => Math.round(1000 * lights.reduce((sum, l) => sum + l[key], 0) / lights.length);
    $(".rig-budget").textContent = lights.length
      ? `A light takes, on average: plan ${mean("plan")} ms, move ${mean("move")} ms, settle ${mean("settle")} ms, expose ${mean("expose")} ms, merge ${mean("merge")} ms, solve ${mean("solve")} ms.`
      : "";
    if (state) plot?.update({ light: state.shown.direction, target: state.target, done: lights });
  }

  /** @param {import("./messages.js").Stored | null} session */
  function offer(session) {
    stored = session;
    const again = button(".rig-continue");
    again.hidden = !session && !former;
    const count = session ? ` (${session.taken} of ${session.lights} lights)` : "";
    again.textContent = former ? `Continue session${count} in folder “${former.name}”` : `Continue${count}`;
  }

  // ---- the port ----

  /** @param {string} text */
  function help(text) {
    $(".rig-help-text").textContent = text;
    find(root, "dialog", HTMLDialogElement).showModal();
  }

  /** @param {any} [chosen] */
  async function listPorts(chosen) {
    remembered = serial() ? await serial().getPorts() : [];
    select(".rig-port").replaceChildren(
      html("option", { value: "simulated" }, "Simulated arm"),
      ...remembered.map((p, i) => html("option", { value: `port${i}`, selected: p === chosen }, portName(p))),
      html("option", { value: "choose" }, "Choose a serial port…"),
    );
  }

  /** Gives the port to a worker of its own where the browser can, else serves it here. @param {any} raw @returns {Promise<MessagePort>} */
  async function serve(raw) {
    const { port1, port2 } = new MessageChannel();
    const worker = portWorker;
    const answer = worker && await new Promise(resolve => {
      worker.onmessage = ({ data }) => resolve(data);
      worker.onerror = () => resolve(null);
      worker.postMessage({ type: "take", info: raw.getInfo(), rig: port1 }, [port1]);
    });
    if (answer?.type === "taken") {
      host = { stop: () => worker?.postMessage({ type: "stop" }), close: () => worker?.postMessage({ type: "close" }) };
    } else {
      host = new Host(raw, answer?.rig ?? port1);
    }
    set(root, { "data-port": answer?.type === "taken" ? "worker" : "page" });
    return port2;
  }

  async function connect() {
    say("");
    const choice = select(".rig-port").value;
    let raw = null;
    try {
      if (choice.startsWith("port")) raw = remembered[Number(choice.slice(4))];
      else if (choice === "choose") {
        const missing = unsupported();
        if (missing) return say(missing);
        raw = await serial().requestPort();
        await listPorts(raw);
      }
    } catch (error) {
      if (/** @type {Error} */ (error).name === "NotFoundError") return help("No port was chosen. If yours was not in the list:");
      return say(explain(error));
    }
    try {
      host = null;
      const port = raw ? await serve(raw) : null;
      await client.call("connect", { rig: port }, port ? [port] : []);
    } catch (error) {
      say(explain(error));
    }
  }

  function stop() {
    const sent = host !== null && state?.shown.phase !== "closed";
    given = [];
    // Straight to the port: two bytes, nothing before them and no worker to wait for.
    if (sent) host?.stop();
    $(".rig-ask").hidden = true;
    client.call("stop", { sent }).catch(failed);
  }

  // ---- the capture ----

  /** @returns {import("./messages.js").Camera} */
  function camera() {
    const kind = select(".rig-camera").value;
    const levels = { black: number(".rig-black") || 0, white: Number.isFinite(number(".rig-white")) ? number(".rig-white") : null };
    if (kind === "folder") {
      if (!watched) throw new Error("Choose the folder that the camera saves to.");
      return { kind, folder: watched, ...levels };
    }
    if (kind === "files") return { kind, ...levels };
    return kind === "webcam" ? { kind } : { kind: "sim" };
  }

  function exposures() {
    const list = input(".rig-exposures").value.split(/[\s,;]+/).filter(Boolean).map(Number);
    // A webcam whose exposure can't be set takes one picture.
    return select(".rig-camera").value === "webcam" && !webcam.exposureRange() ? list.slice(-1) : list;
  }

  /** @returns {import("./messages.js").CaptureSettings} */
  function settings() {
    const sim = select(".rig-camera").value === "sim";
    const ball = sim ? input(".rig-ball").checked : input(".rig-mirror").checked;
    return {
      camera: sim ? "sim" : "frames",
      object: sim ? select(".rig-object").value : input(".rig-name").value.trim() || "object",
      material: "lambert:0.8",
      size: 96,
      planner: select(".rig-planner").value,
      solver: select(".rig-solver").value,
      lights: typed(".rig-lights", "Lights", true),
      stop_at: number(".rig-stop-at") > 0 ? number(".rig-stop-at") : null,
      seed: typed(".rig-seed", "Seed", true),
      reach: typed(".rig-reach", "Largest slant"),
      nearby: number(".rig-nearby") > 0 ? number(".rig-nearby") : null,
      exposures: exposures(),
      settle: typed(".rig-settle", "Time to settle"),
      brightness: typed(".rig-brightness", "LED"),
      shutter: input(".rig-shutter").checked,
      dark: input(".rig-dark").checked,
      homing: input(".rig-homing").checked,
      sphere: !ball ? null : sim ? { x: 0, y: 0, radius: 1 } : mask.outline,
      misaligned: sim && input(".rig-askew").checked ? ASKEW : [0, 0, 0, 0],
    };
  }

  /** @param {"auto" | "one"} mode @param {boolean} again whether the stored session goes on */
  async function begin(mode, again) {
    say("");
    given = [];
    try {
      if (again && stored && !stored.simulated && select(".rig-camera").value === "sim") {
        throw new Error("This session was taken with a camera: choose it first, then continue.");
      }
      if (!again && input(".rig-mirror").checked && select(".rig-camera").value !== "sim" && !mask.outline) {
        throw new Error("Mark the mirror sphere first, or untick it.");
      }
      await client.call("begin", { mode, settings: settings(), camera: camera(), stored: again });
    } catch (error) {
      failed(error);
      offer(stored);
      $(".rig-discard").hidden = /** @type {Error} */ (error).name !== "Unsaved";
    }
  }

  /** One picture, for the drawing or an exposure. @param {number} milliseconds @returns {Promise<import("./messages.js").Shot | null>} */
  async function picture(milliseconds) {
    if (select(".rig-camera").value === "webcam") return webcam.take(milliseconds, Math.max(1, number(".rig-average") || 1));
    if (!given.length) given = await chooseImages() ?? [];
    const file = given.shift();
    return file ? { bytes: await file.arrayBuffer(), milliseconds } : null;
  }

  /** @param {import("./messages.js").Expose} asked */
  async function expose({ number: k, index, milliseconds, count }) {
    try {
      if (select(".rig-camera").value === "files" && !given.length) {
        // A dialog needs a click.
        const what = k ? `light ${k}` : "the dark frame";
        button(".rig-give").textContent = `Choose ${count - index === 1 ? "the image" : `the ${count - index} images`} of ${what}`;
        $(".rig-ask").hidden = false;
        button(".rig-give").focus();
        page.announce(`Images of ${what} are needed`);
        await new Promise(resolve => {
          gave = () => {
            if (given.length <= count - index) return resolve(null);
            say(`${given.length} images were chosen where ${what} needs ${count - index}: choose again.`);
            given = [];
          };
        });
        $(".rig-ask").hidden = true;
      }
      const shot = await picture(milliseconds);
      await client.call("exposed", { shot, reason: "no image was given" }, shot && "bitmaps" in shot ? shot.bitmaps : []);
    } catch (error) {
      await client.call("exposed", { shot: null, reason: explainCamera(error) }).catch(failed);
    }
  }

  // ---- what people do ----

  /** @param {import("./messages.js").Order} order */
  async function order(order) {
    say("");
    try {
      const { projected } = await client.call("order", { order });
      if (projected > 0) say(`Out of the arm's range: going to the nearest reachable direction, ${projected.toFixed(1)}° off.`);
    } catch (error) {
      failed(error);
    }
  }

  for (const control of root.querySelectorAll("[data-do]")) {
    /** @returns {import("./messages.js").Order} */
    const asked = () => {
      const name = /** @type {HTMLElement} */ (control).dataset.do ?? "";
      if (name === "goto") return { name, azimuth: typed(".rig-az", "Azimuth"), slant: typed(".rig-sl", "Slant") };
      if (name === "lightOn") return { name: "light", brightness: typed(".rig-brightness", "LED") };
      if (name === "lightOff") return { name: "light", brightness: 0 };
      return { name: /** @type {import("./messages.js").Plain} */ (name) };
    };
    control.addEventListener("click", () => {
      try {
        return order(asked());
      } catch (error) {
        failed(error);
      }
    });
  }
  for (const control of root.querySelectorAll("[data-jog]")) {
    control.addEventListener("click", () => {
      const [a, s] = (/** @type {HTMLElement} */ (control).dataset.jog ?? "0,0").split(",").map(Number);
      const step = Number(select(".rig-step").value);
      return order({ name: "jog", azimuth: a * step, slant: s * step });
    });
  }
  on(".rig-stop", stop);
  document.addEventListener("keydown", event => {
    if (event.key === "Escape" && !root.hidden && state?.shown.phase !== "closed") stop();
  });
  on(".rig-connect", () => state?.wanted || state && state.shown.phase !== "closed" ? client.call("disconnect", {}).catch(failed) : connect());
  on(".rig-auto", () => begin("auto", false));
  on(".rig-next", () => begin("one", false));
  on(".rig-give", async () => {
    given = await chooseImages() ?? [];
    if (given.length) gave();
  });
  on(".rig-pause", () => {
    $(".rig-ask").hidden = true;
    given = [];
    client.call("pause", {}).catch(failed);
  });
  on(".rig-discard", async () => {
    try {
      await client.call("discard", {});
      $(".rig-discard").hidden = true;
      button(".rig-auto").focus();
    } catch (error) {
      failed(error);
    }
  });
  on(".rig-continue", async () => {
    if (former && !await openFormer(former)) return;
    await begin("auto", true);
  });
  on(".rig-copy", () => navigator.clipboard.writeText(log.join("\n")).catch(failed));
  $(".rig-type").addEventListener("submit", event => {
    event.preventDefault();
    const line = input(".rig-line").value.trim();
    if (line) void order({ name: "raw", line });
    input(".rig-line").value = "";
  });
  let relighting = false;
  async function relight() {
    if (relighting) return;
    relighting = true;
    const light = () => ({ azimuth: number(".rig-rel-az"), slant: number(".rig-rel-sl") });
    try {
      for (let before = ""; before !== JSON.stringify(light());) {
        before = JSON.stringify(light());
        const picture = await client.call("relight", light());
        if (picture) draw(canvas(".rig-relit"), picture);
      }
    } catch (error) {
      failed(error);
    } finally {
      relighting = false;
    }
  }
  for (const range of [".rig-rel-az", ".rig-rel-sl"]) input(range).addEventListener("input", () => void relight());

  select(".rig-camera").addEventListener("change", () => {
    const kind = select(".rig-camera").value;
    for (const part of root.querySelectorAll(".rig-of")) {
      /** @type {HTMLElement} */ (part).hidden = !(/** @type {HTMLElement} */ (part).dataset.camera?.split(" ").includes(kind));
    }
    $(".rig-real").hidden = kind === "sim";
    $(".rig-watch").hidden = kind !== "folder";
    given = [];
    if (kind === "webcam") listCameras().catch(error => say(explainCamera(error)));
    else webcam.close();
  });
  async function listCameras() {
    const missing = Webcam.unsupported();
    if (missing) return say(missing);
    const chosen = webcam.track?.getSettings().deviceId ?? "";
    const devices = await Webcam.devices();
    select(".rig-device").replaceChildren(
      html("option", { value: "" }, "Any camera"),
      ...devices.filter(d => d.deviceId).map((d, i) => html("option", { value: d.deviceId, selected: d.deviceId === chosen }, d.label || `Camera ${i + 1}`)),
    );
  }
  on(".rig-open-camera", async () => {
    say("");
    try {
      await webcam.open(select(".rig-device").value);
      await listCameras();
      const { held, free } = await webcam.lock();
      const range = webcam.exposureRange();
      const { width, height } = webcam.track?.getSettings() ?? {};
      $(".rig-locks").textContent = [
        `${width} × ${height} pixels.`,
        held.length ? `Held still: ${held.join(", ")}.` : "",
        free.length ? `This camera does not let the page hold ${free.join(", ")}: switch off what changes by itself in its own program.` : "",
        range ? `Exposures from ${range.least} to ${range.most} ms can be set.` : "Its exposure time can't be set: one exposure is taken for each light.",
        "Its pictures are taken as sRGB; normals from it are rough.",
      ].filter(Boolean).join(" ");
    } catch (error) {
      say(explainCamera(error));
    }
  });
  on(".rig-watch", async () => {
    try {
      watched = await chooseFolder("read", "rig-camera");
      if (watched) button(".rig-watch").textContent = `Watching “${watched.name}”`;
      else say("This browser can't watch folders, or none was chosen. Images can be chosen for each light instead.");
    } catch (error) {
      say(explain(error));
    }
  });
  on(".rig-look", async () => {
    say("");
    try {
      const kind = select(".rig-camera").value;
      const milliseconds = exposures().at(-1) ?? 10;
      const shot = kind === "folder" ? await chooseImages().then(async files => files && { bytes: await files[0].arrayBuffer(), milliseconds }) : await picture(milliseconds);
      given = [];
      const from = kind === "webcam" ? /** @type {const} */ ({ kind }) : { .../** @type {any} */ (camera()), folder: null };
      if (shot) mask.show(await client.call("look", { shot, camera: from }, "bitmaps" in shot ? shot.bitmaps : []));
    } catch (error) {
      say(explainCamera(error));
    }
  });
  input(".rig-mirror").addEventListener("change", () => { mask.sphere = input(".rig-mirror").checked; });
  on(".rig-fit-arm", async () => {
    try {
      const { mount: [a, s, x, y], before, after, count, arm } = await client.call("fit", {});
      localStorage.setItem(ARM_KEY, arm);
      $(".rig-fitted").textContent = `Zero: azimuth ${a.toFixed(2)}°, slant ${s.toFixed(2)}°; tilt ${x.toFixed(2)}°, ${y.toFixed(2)}°. Largest deviation of ${count} directions: ${before.toFixed(2)}° before, ${after.toFixed(2)}° after. Kept for this browser; the next capture goes by it.`;
    } catch (error) {
      $(".rig-fitted").textContent = /** @type {Error} */ (error).message;
    }
  });
  on(".rig-unfit", async () => {
    localStorage.removeItem(ARM_KEY);
    try {
      await client.call("unfit", {});
      $(".rig-fitted").textContent = "The arm is taken to stand as it is drawn.";
    } catch (error) {
      $(".rig-fitted").textContent = /** @type {Error} */ (error).message;
    }
  });
  /** @param {FileSystemDirectoryHandle | null} folder */
  async function keep(folder) {
    const { session, shown } = await client.call("keep", { folder, settings: settings() });
    former = null;
    offer(session);
    if (!shown) return;
    const { object, taken, lights: all } = shown;
    say(`“${folder?.name}” holds ${session ? "an unfinished" : "a complete"} session of “${object}”, ${taken} of ${all} lights: shown here.`);
  }

  /** Asks for the folder of before the reload. Without it the browser's own copy can go on. @param {FileSystemDirectoryHandle} folder */
  async function openFormer(folder) {
    say("");
    try {
      const answer = await /** @type {any} */ (folder).requestPermission({ mode: "readwrite" });
      if (answer !== "granted") throw new Error("the browser was not allowed to use it");
      await keep(folder);
      return stored !== null;
    } catch (error) {
      former = null;
      offer(stored);
      const rest = stored ? "Continue goes on with the copy in this browser" : "There is no other copy in this browser";
      say(`The folder “${folder.name}” can't be opened: ${explain(error)}. ${rest}; or choose the folder again.`);
      return false;
    }
  }

  on(".rig-folder", async () => {
    try {
      const folder = await chooseFolder("readwrite", "rig-session");
      say(folder ? "" : "This browser can't write to folders, or none was chosen: the session stays in the browser, download it as zip.");
      if (folder) await keep(folder);
    } catch (error) {
      say(explain(error));
    }
  });
  on(".rig-no-folder", () => keep(null).catch(failed));
  on(".rig-zip", async () => {
    try {
      download(new Blob([await client.call("zip", {})], { type: "application/zip" }), "session.zip");
    } catch (error) {
      failed(error);
    }
  });
  addEventListener("pagehide", () => { host?.close(); webcam.close(); });

  if (serial()) portWorker = new Worker(new URL("port-worker.js", import.meta.url), { type: "module", name: "coil-ps-port" });
  const { limits, fitted, session, folder } = await client.call("start", { arm: localStorage.getItem(ARM_KEY), pace: pace() });
  if (localStorage.getItem(ARM_KEY)) {
    $(".rig-fit").hidden = false;
    $(".rig-fitted").textContent = fitted
      ? "The arm goes by the fit of an earlier session."
      : "The fit of an earlier session can't be read and was dropped: the arm is taken to stand as it is drawn. Fit it again.";
    if (!fitted) localStorage.removeItem(ARM_KEY);
  }
  plot = new Plot(limits);
  $(".rig-dome").append(plot.element);
  const catalogue = await page.engine.call("catalogue", {});
  const planners = catalogue.planners.filter(p => !p.oracle);
  const ours = ["coil", "tk22"].find(name => planners.some(p => p.name === name)); // coil, where its module is built
  select(".rig-planner").replaceChildren(...planners.map(p => html("option", { value: p.name, selected: p.name === ours }, p.label)));
  $(".rig-withheld").hidden = !catalogue.withheld;
  $(".rig-withheld").textContent = catalogue.withheld;
  select(".rig-solver").replaceChildren(...catalogue.solvers.filter(s => s.name !== "pixel").map(s => html("option", { value: s.name, selected: s.name === "trimmed", title: s.about }, s.name)));
  await listPorts();
  former = folder;
  offer(session);
}
