// The rig view: an arm on a serial port (or the simulated one), its position, and a capture that drives it. What
// the bytes mean, what to send and where to go is computed in the core (web/serial.rs); here are port, clock, storage
// and what is shown. Runs in the page's own thread: `requestPort` exists only there, and Stop must not wait for a worker.

import init, { Rig } from "../pkg/core/coil_ps.js";
import { download, draw, find, html, set } from "../svg.js";
import { Port, explain, portName, serial, unsupported } from "./port.js";
import { Plot } from "./plot.js";
import { SimulatedPort } from "./simulated.js";
import { chosenFolder, clear, ownFolder, read, write } from "./storage.js";

const LOG_LINES = 500;
/** A USB port takes so long to come back. */
const RECONNECT_MS = 8000;
/** Read-out of the simulated camera. */
const READ_OUT_MS = 30;

const now = () => performance.now();
const sleep = (/** @type {number} */ ms) => new Promise(resolve => setTimeout(resolve, ms));

/**
 * @param {HTMLElement} root
 * @param {import("../main.js").Page} page
 */
export async function mount(root, page) {
  await init({ module_or_path: new URL("../pkg/core/coil_ps_bg.wasm", import.meta.url) });
  if (!document.querySelector("link[href$='rig/rig.css']")) {
    document.head.append(html("link", { rel: "stylesheet", href: new URL("rig.css", import.meta.url).href }));
  }
  root.classList.add("rig");
  root.innerHTML = `
    <section class="card rig-bar" aria-label="Connection">
      <select class="rig-port" aria-label="Arm"></select>
      <button type="button" class="button primary rig-connect">Connect</button>
      <span class="rig-state" role="status">Not connected</span>
      <button type="button" class="rig-stop" title="Stops at once: hold and reset, past everything queued (Escape)">STOP</button>
    </section>
    <section class="card" aria-labelledby="rig-arm-title">
      <h2 id="rig-arm-title">Arm</h2>
      <p class="rig-said" aria-live="assertive"></p>
      <div class="rig-dome"></div>
      <dl class="rig-read"><dt>State</dt><dd class="rd-state">–</dd><dt>Azimuth</dt><dd class="rd-azimuth">–</dd><dt>Slant</dt><dd class="rd-slant">–</dd><dt>Position</dt><dd class="rd-trust">–</dd><dt>LED</dt><dd class="rd-led">–</dd></dl>
      <div class="row"><button type="button" class="button" data-do="home">Home</button><button type="button" class="button" data-do="unlock">Unlock</button><button type="button" class="button" data-do="hold">Hold</button><button type="button" class="button" data-do="resume">Resume</button><button type="button" class="button" data-do="release">Release Stop</button><button type="button" class="button" data-do="reset">Reset</button></div>
      <div class="row"><label>Azimuth <input type="number" class="rig-az" value="30" min="-360" max="360" step="1"></label><label>Slant <input type="number" class="rig-sl" value="40" min="-90" max="90" step="1"></label><button type="button" class="button" data-do="goto">Go to</button></div>
      <div class="row"><div class="rig-jog" role="group" aria-label="Jog"><span></span><button type="button" class="button" data-jog="0,1" aria-label="Slant up">S+</button><span></span><button type="button" class="button" data-jog="-1,0" aria-label="Azimuth down">A−</button><button type="button" class="button" data-do="jogCancel" aria-label="End the jog">■</button><button type="button" class="button" data-jog="1,0" aria-label="Azimuth up">A+</button><span></span><button type="button" class="button" data-jog="0,-1" aria-label="Slant down">S−</button><span></span></div>
        <label>by <select class="rig-step"><option>0.1</option><option>1</option><option selected>5</option><option>20</option></select>°</label><button type="button" class="button" data-do="lightOn">LED on</button><button type="button" class="button" data-do="lightOff">LED off</button></div>
      <ul class="rig-findings"></ul>
    </section>
    <section class="card" aria-labelledby="rig-capture-title">
      <h2 id="rig-capture-title">Capture</h2>
      <div class="row"><label>Object <select class="rig-object"><option value="blob:7">Blob</option><option value="sphere">Sphere</option><option value="bowl">Bowl</option></select></label><label>Planner <select class="rig-planner"></select></label></div>
      <div class="row"><label>Lights <input type="number" class="rig-lights" value="10" min="3" max="100"></label><label>Seed <input type="number" class="rig-seed" value="1" min="0"></label></div>
      <div class="row"><button type="button" class="button primary rig-auto">Capture</button><button type="button" class="button rig-next">One light</button><button type="button" class="button rig-pause" disabled>Pause</button><button type="button" class="button rig-continue" hidden>Continue</button></div>
      <div class="row"><button type="button" class="button small rig-folder">Save to a folder…</button><button type="button" class="button small rig-zip">Download zip</button></div>
      <p class="rig-progress" role="status">The session is stored in this browser as it goes.</p>
      <p class="note">Images come from the simulated camera, which sees the chosen object under the light where the arm has it.</p>
    </section>
    <section class="card" aria-labelledby="rig-seen-title">
      <h2 id="rig-seen-title">Images and normals</h2>
      <div class="rig-maps"><figure><canvas class="rig-photo" width="8" height="8"></canvas><figcaption>Last image</figcaption></figure><figure><canvas class="rig-normals" width="8" height="8"></canvas><figcaption class="rig-error">Normals</figcaption></figure><figure><canvas class="rig-relit" width="8" height="8"></canvas><figcaption>Relit</figcaption></figure></div>
      <div class="row"><label>Light azimuth <input type="range" class="rig-rel-az" min="-180" max="180" value="40"></label><label>slant <input type="range" class="rig-rel-sl" min="0" max="85" value="45"></label></div>
      <div class="rig-table" tabindex="0" role="region" aria-label="Lights taken"></div>
    </section>
    <section class="card rig-log" aria-labelledby="rig-log-title">
      <div class="head"><h2 id="rig-log-title">Console</h2><button type="button" class="button small rig-copy">Copy</button></div>
      <div class="rig-lines" tabindex="0" role="log" aria-label="Lines sent and received"></div>
      <form class="row rig-type"><label>Line <input class="rig-line" autocomplete="off" spellcheck="false" size="28" placeholder="$$"></label><button class="button">Send</button></form>
    </section>
    <dialog aria-labelledby="rig-help-title"><h2 id="rig-help-title">No port chosen</h2><p class="rig-help-text"></p><ul>
      <li>Is the cable a data cable? Many only charge.</li>
      <li>Boards with a CH340 or CP210x chip need its driver on Windows and older macOS.</li>
      <li>On Linux your user must be in the group <code>dialout</code>: <code>sudo usermod -aG dialout $USER</code>, then log in again.</li>
      <li>Close other programs that use the board: Arduino IDE, serial monitors, other tabs.</li>
      <li>The board must run stock Grbl 1.1 at 115200 baud.</li></ul>
      <form method="dialog" class="row"><button class="button primary">Close</button></form></dialog>`;

  const $ = (/** @type {string} */ selector) => find(root, selector, HTMLElement);
  const field = (/** @type {string} */ selector) => /** @type {HTMLInputElement} */ (root.querySelector(selector));
  const canvas = (/** @type {string} */ selector) => find(root, selector, HTMLCanvasElement);

  const rig = new Rig();
  const plot = new Plot([...rig.limits()]);
  $(".rig-dome").append(plot.element);

  /** @type {Port | null} */
  let port = null;
  /** @type {any[]} */
  let remembered = [];
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let timer;
  let wanted = false; // the user wants to be connected
  /** @type {"idle" | "auto" | "one"} */
  let mode = "idle";
  let capturing = false;
  let advancing = false;
  /** @type {FileSystemDirectoryHandle | null} */
  let folder = null;
  /** @type {[number, number, number] | null} */
  let target = null;
  /** @type {string[]} */
  const log = [];
  let phaseBefore = "";

  // ---- what is shown ----

  const say = (/** @type {string} */ text) => { $(".rig-said").textContent = text; };

  function addLog(/** @type {{ kind: string, text: string }} */ { kind, text }) {
    const stamp = new Date().toISOString().slice(11, 23);
    const mark = /** @type {Record<string, string>} */ ({ sent: ">", received: "<", note: "#", failed: "!" })[kind];
    const line = `${stamp} ${mark} ${text}`;
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

  function show() {
    for (const said of rig.takeLog()) addLog(said);
    const s = rig.shown();
    const words = /** @type {Record<string, string>} */ ({
      closed: s.reason ? `Disconnected: ${s.reason}` : "Not connected",
      opening: "Port open, waiting for the firmware…",
      reading: `Grbl ${s.version} found, reading its settings…`,
      ready: `Connected: Grbl ${s.version}`,
      stopped: s.confirmed ? "Stopped. Release Stop, then home." : "Stopping…",
    })[s.phase];
    $(".rig-state").textContent = wanted && s.phase === "closed" ? "Trying to reconnect…" : words;
    set(root, { "data-phase": s.phase });
    $(".rd-state").textContent = s.phase === "closed" ? "–" : s.state ?? "not known";
    $(".rd-azimuth").textContent = s.azimuth === null ? "–" : `${s.azimuth.toFixed(2)}°`;
    $(".rd-slant").textContent = s.slant === null ? "–" : `${s.slant.toFixed(2)}°`;
    $(".rd-trust").textContent = s.phase === "closed" ? "–" : { homed: "known, homed", assumed: "counted from where it was switched on", lost: "lost: home the arm" }[/** @type {"homed"} */ (s.trust)];
    $(".rd-led").textContent = s.led === null ? "–" : s.led ? `S${s.led}` : "off";
    $(".rig-connect").textContent = wanted || s.phase !== "closed" ? "Disconnect" : "Connect";
    if (s.phase === "ready" && phaseBefore !== "ready") {
      $(".rig-findings").replaceChildren(...rig.findings().map((/** @type {any} */ f) => html("li", { class: f.kind === "error" ? "rig-said" : "note" }, f.text)));
      if (phaseBefore === "reading") page.announce("The arm is connected");
    }
    if (s.phase === "stopped") page.announce("Stopped");
    phaseBefore = s.phase;
    const lights = rig.lights();
    const done = lights.map((/** @type {any} */ l) => l.used);
    plot.update({ light: s.direction, target, done });
    return s;
  }

  function showPictures() {
    const lights = rig.lights();
    const put = (/** @type {string} */ selector, /** @type {any} */ picture) => {
      if (!picture) return;
      draw(canvas(selector), { width: picture.width, height: picture.height, data: picture.rgba });
      picture.free();
    };
    if (lights.length) put(".rig-photo", rig.photo(lights.length - 1));
    put(".rig-normals", rig.normals());
    const error = rig.error();
    $(".rig-error").textContent = error === undefined ? "Normals (from 3 lights)" : `Normals, error ${error.toFixed(2)}°`;
    relight();
    const percent = (/** @type {number} */ v) => `${(100 * v).toFixed(1)} %`;
    const rows = lights.map((/** @type {any} */ l, /** @type {number} */ i) => html("tr", {}, ...[String(i + 1), l.projected ? `${l.projected.toFixed(1)}° off` : "exact", percent(l.saturated), percent(l.dark), percent(l.noise), `${l.move.toFixed(2)} s`].map(t => html("td", {}, t))));
    const head = html("tr", {}, ...["Light", "Reached", "Saturated", "Dark", "Noise", "Move"].map(t => html("th", { scope: "col" }, t)));
    $(".rig-table").replaceChildren(html("table", {}, html("thead", {}, head), html("tbody", {}, ...rows)));
  }

  function relight() {
    const picture = rig.relight(Number(field(".rig-rel-az").value), Number(field(".rig-rel-sl").value));
    if (!picture) return;
    draw(canvas(".rig-relit"), { width: picture.width, height: picture.height, data: /** @type {any} */ (picture.rgba) });
    picture.free();
  }

  // ---- the port ----

  function pump() {
    clearTimeout(timer);
    if (!port) return void show();
    const bytes = rig.tick(now());
    if (bytes.length) port.write(bytes);
    const s = show();
    if (s.phase === "closed") return void lost(s.reason ?? "the firmware does not answer");
    timer = setTimeout(pump, Math.max((rig.wake(now()) ?? now() + 200) - now(), 1));
    advance();
  }

  /** @param {any} raw */
  async function open(raw) {
    /** @type {Port} */
    const mine = new Port(raw, {
      bytes: bytes => { if (port === mine) { rig.receive(now(), bytes); pump(); } },
      lost: reason => { if (port === mine) lost(reason); },
    });
    await mine.open();
    port = mine;
    rig.opened(now());
    // Before anything is asked of the capture: stuck for the port that was lost, it would end what it can now go on with.
    rig.retry();
    pump();
  }

  /** @param {string} reason */
  async function lost(reason) {
    const gone = port;
    if (!gone) return;
    port = null;
    rig.closed(reason);
    show();
    await gone.close();
    if (!wanted) return;
    const said = rig.shown().reason;
    // A board that does not speak Grbl will not speak it on the next try either.
    if (/not as Grbl|did not confirm/.test(said ?? "")) {
      wanted = false;
      show();
      return help("The port opened, but nothing there speaks Grbl 1.1 at 115200 baud.");
    }
    const end = now() + RECONNECT_MS;
    while (wanted && now() < end) {
      await sleep(400);
      // After a re-enumeration the same device may be another object.
      const again = serial() && !(gone.raw instanceof SimulatedPort) ? (await serial().getPorts()).find((/** @type {any} */ p) => p === gone.raw) ?? gone.raw : gone.raw;
      try {
        return await open(again);
      } catch { /* not there yet */ }
    }
    wanted = false;
    show();
    addLog({ kind: "failed", text: `The port did not come back in ${RECONNECT_MS / 1000} s (${reason}). The session is stored: connect and continue.` });
  }

  /** @param {string} text */
  function help(text) {
    $(".rig-help-text").textContent = text;
    find(root, "dialog", HTMLDialogElement).showModal();
  }

  async function connect() {
    say("");
    const choice = /** @type {HTMLSelectElement} */ (root.querySelector(".rig-port")).value;
    let raw;
    try {
      if (choice === "simulated") raw = new SimulatedPort();
      else if (choice.startsWith("port")) raw = remembered[Number(choice.slice(4))];
      else {
        const missing = unsupported();
        if (missing) return say(missing);
        raw = await serial().requestPort();
        await listPorts(raw);
      }
    } catch (error) {
      if (/** @type {Error} */ (error).name === "NotFoundError") return help("No port was chosen. If yours was not in the list:");
      return say(explain(error));
    }
    wanted = true;
    show();
    try {
      await open(raw);
    } catch (error) {
      wanted = false;
      show();
      say(explain(error));
    }
  }

  async function disconnect() {
    wanted = false;
    mode = "idle";
    const gone = port;
    port = null;
    clearTimeout(timer);
    rig.closed(undefined);
    show();
    await gone?.close();
  }

  /** @param {any} [chosen] */
  async function listPorts(chosen) {
    remembered = serial() ? await serial().getPorts() : [];
    const select = /** @type {HTMLSelectElement} */ (root.querySelector(".rig-port"));
    select.replaceChildren(
      html("option", { value: "simulated" }, "Simulated arm"),
      ...remembered.map((p, i) => html("option", { value: `port${i}`, selected: p === chosen }, portName(p))),
      html("option", { value: "choose" }, "Choose a serial port…"),
    );
  }

  function stop() {
    mode = "idle";
    if (!port) return;
    rig.stop(now());
    // Straight to the port: two bytes, nothing before them.
    port.write(rig.takeOutput());
    pump();
  }

  // ---- the capture ----

  const idle = () => mode === "idle"; // it changes while a capture waits

  async function advance() {
    if (advancing || !capturing || idle() || !port) return;
    advancing = true;
    try {
      for (;;) {
        if (idle() || !port) return;
        const doing = rig.step(now());
        const out = rig.takeOutput();
        if (out.length) port.write(out);
        target = doing.commanded;
        $(".rig-progress").textContent = doing.action === "done" ? `${doing.taken} of ${doing.lights} lights. Done.` : `Light ${doing.taken + 1} of ${doing.lights}: ${doing.doing}${doing.projected ? ` (out of reach, projected by ${doing.projected.toFixed(1)}°)` : ""}`;
        if (doing.action === "wait") {
          if (doing.until !== null) setTimeout(pump, Math.max(doing.until - now(), 1));
          return;
        }
        if (doing.action === "expose") {
          const board = port.raw instanceof SimulatedPort || "board" in port.raw ? /** @type {any} */ (port.raw).board : null;
          const s = rig.shown();
          const [azimuth, slant, led] = board ? board.truth() : [s.azimuth ?? 0, s.slant ?? 0, s.led ?? 0];
          const seconds = doing.until / 1000;
          await sleep(doing.until + READ_OUT_MS);
          // What happened meanwhile decides whether the exposure is still wanted.
          if (rig.step(now()).action === "expose") rig.exposeSimulated(azimuth, slant, led, seconds);
          continue;
        }
        if (doing.action === "store") {
          const files = rig.takeFiles();
          await save(files);
          rig.stored();
          showPictures();
          show();
          if (mode === "one") {
            setMode("idle");
            $(".rig-progress").textContent = `${doing.taken + 1} of ${doing.lights} lights. Paused.`;
            return;
          }
          continue;
        }
        if (doing.action === "done") {
          setMode("idle");
          capturing = false;
          offerContinue();
          page.announce("The capture is done");
          return;
        }
        setMode("idle");
        $(".rig-progress").textContent = `${doing.taken} of ${doing.lights} lights are stored. ${doing.reason ?? ""}`;
        return;
      }
    } catch (error) {
      setMode("idle");
      page.problem("The capture can't go on", error, "What was captured is stored; continue when the cause is mended.");
    } finally {
      advancing = false;
    }
  }

  /** @param {import("../pkg/core/coil_ps.js").SessionFile[]} files */
  async function save(files) {
    const copies = folder ? files.map(f => ({ name: f.name, bytes: f.bytes, free() {} })) : [];
    await write(await ownFolder(), files);
    if (folder) await write(folder, /** @type {any} */ (copies));
  }

  /** @param {"idle" | "auto" | "one"} next */
  function setMode(next) {
    mode = next;
    /** @type {HTMLButtonElement} */ (root.querySelector(".rig-pause")).disabled = next === "idle";
  }

  /** @param {"auto" | "one"} next */
  async function begin(next) {
    say("");
    if (!port) return say("Connect the arm first: the simulated one needs no hardware.");
    if (!capturing) {
      try {
        rig.startCapture(field(".rig-object").value, "lambert:0.8", 96, field(".rig-planner").value, Number(field(".rig-lights").value), Number(field(".rig-seed").value), undefined);
      } catch (error) {
        return say(/** @type {Error} */ (error).message);
      }
      await clear(await ownFolder());
      await save(rig.takeFiles());
      capturing = true;
    } else rig.retry();
    setMode(next);
    $(".rig-continue").hidden = true;
    pump();
  }

  async function continueSession() {
    say("");
    if (!port) return say("Connect the arm first.");
    try {
      rig.startCapture("", "", 0, "", 0, 0, await read(await ownFolder()));
    } catch (error) {
      return say(/** @type {Error} */ (error).message);
    }
    await save(rig.takeFiles());
    capturing = true;
    showPictures();
    setMode("auto");
    $(".rig-continue").hidden = true;
    pump();
  }

  async function offerContinue() {
    const button = $(".rig-continue");
    button.hidden = true;
    try {
      const found = (await read(await ownFolder())).summary();
      if (found.taken < found.lights) {
        button.textContent = `Continue (${found.taken} of ${found.lights} lights)`;
        button.hidden = false;
      }
    } catch { /* no session stored */ }
  }

  // ---- what people do ----

  /** @param {() => unknown} work */
  function attempt(work) {
    say("");
    try {
      work();
    } catch (error) {
      say(/** @type {Error} */ (error).message);
    }
    pump();
  }

  const commands = /** @type {Record<string, () => unknown>} */ ({
    home: () => rig.home(now()),
    unlock: () => rig.unlock(now()),
    hold: () => rig.hold(),
    resume: () => rig.resume(),
    release: () => rig.release(now()),
    reset: () => rig.reset(now()),
    jogCancel: () => rig.jogCancel(),
    lightOn: () => rig.light(now(), 800),
    lightOff: () => rig.light(now(), 0),
    goto: () => {
      const projected = rig.goto(now(), Number(field(".rig-az").value), Number(field(".rig-sl").value));
      if (projected > 0) say(`Out of the arm's range: going to the nearest reachable direction, ${projected.toFixed(1)}° off.`);
    },
  });
  for (const button of root.querySelectorAll("[data-do]")) {
    button.addEventListener("click", () => {
      let projected = "";
      attempt(() => { commands[/** @type {HTMLElement} */ (button).dataset.do ?? ""](); projected = $(".rig-said").textContent ?? ""; });
      if (projected) say(projected);
    });
  }
  for (const button of root.querySelectorAll("[data-jog]")) {
    button.addEventListener("click", () => {
      const [a, s] = (/** @type {HTMLElement} */ (button).dataset.jog ?? "0,0").split(",").map(Number);
      const step = Number(field(".rig-step").value);
      attempt(() => rig.jog(now(), a * step, s * step));
    });
  }
  $(".rig-stop").addEventListener("click", stop);
  document.addEventListener("keydown", event => { if (event.key === "Escape" && port && !root.hidden) stop(); });
  $(".rig-connect").addEventListener("click", () => (wanted || port ? disconnect() : connect()));
  $(".rig-auto").addEventListener("click", () => begin("auto"));
  $(".rig-next").addEventListener("click", () => begin("one"));
  $(".rig-pause").addEventListener("click", () => { setMode("idle"); $(".rig-progress").textContent = "Paused."; });
  $(".rig-continue").addEventListener("click", continueSession);
  for (const range of [".rig-rel-az", ".rig-rel-sl"]) field(range).addEventListener("input", relight);
  $(".rig-copy").addEventListener("click", () => navigator.clipboard.writeText(log.join("\n")));
  $(".rig-type").addEventListener("submit", event => {
    event.preventDefault();
    const line = field(".rig-line").value.trim();
    if (line) attempt(() => rig.raw(now(), line));
    field(".rig-line").value = "";
  });
  $(".rig-folder").addEventListener("click", async () => {
    try {
      folder = await chosenFolder();
      say(folder ? "" : "This browser can't write to folders, or none was chosen: the session stays in the browser, download it as zip.");
      if (folder) $(".rig-folder").textContent = `Also saved to “${folder.name}”`;
    } catch (error) {
      say(explain(error));
    }
  });
  $(".rig-zip").addEventListener("click", async () => {
    const files = await read(await ownFolder());
    download(new Blob([/** @type {BlobPart} */ (files.zip("session"))], { type: "application/zip" }), "session.zip");
  });
  addEventListener("pagehide", () => void port?.close());

  const catalogue = await page.engine.call("catalogue", {});
  $(".rig-planner").replaceChildren(...catalogue.planners.filter(p => !p.oracle).map(p => html("option", { value: p.name, selected: p.name === "tk22" }, p.label)));
  await listPorts();
  await offerContinue();
  show();
}
