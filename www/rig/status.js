// What the worker tells, shown: the arm and its console, the lights taken, the newest pictures, and how the arm stands.

import { draw, html, set } from "../svg.js";
import { Plot } from "./plot.js";

const LOG_LINES = 500;
const ARM_KEY = "coil-ps.arm";
const MARKS = /** @type {Record<string, string>} */ ({ sent: ">", received: "<", note: "#", failed: "!" });

/**
 * @param {HTMLElement} root
 * @param {import("./rig.js").Panel} panel
 */
export function mountStatus(root, { page, client, fields, say, failed }) {
  const { $, input, button, canvas, number, on } = fields;
  /** @type {Plot | null} */
  let plot = null;
  /** @type {import("./messages.js").State | null} */
  let state = null;
  /** @type {import("./messages.js").LightTaken[]} */
  let lights = [];
  /** @type {string[]} */
  const log = [];
  /** How an earlier fit says that the arm stands, for the core to read. */
  const keptFit = () => localStorage.getItem(ARM_KEY);

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
    $(".rig-fit").hidden = !measured && !keptFit();
    $(".rig-notes").replaceChildren(...told.notes.slice(-6).map(note => html("li", {}, note)));
    const mean = (/** @type {"plan" | "move" | "settle" | "expose" | "merge" | "solve"} */ key) => Math.round(1000 * lights.reduce((sum, l) => sum + l[key], 0) / lights.length);
    $(".rig-budget").textContent = lights.length
      ? `A light takes, on average: plan ${mean("plan")} ms, move ${mean("move")} ms, settle ${mean("settle")} ms, expose ${mean("expose")} ms, merge ${mean("merge")} ms, solve ${mean("solve")} ms.`
      : "";
    if (state) plot?.update({ light: state.shown.direction, target: state.target, done: lights });
  }

  /** What the worker began with. @param {number[]} limits of the arm @param {boolean} fitted whether the arm goes by the fit that is kept */
  function started(limits, fitted) {
    if (keptFit()) {
      $(".rig-fit").hidden = false;
      $(".rig-fitted").textContent = fitted
        ? "The arm goes by the fit of an earlier session."
        : "The fit of an earlier session can't be read and was dropped: the arm is taken to stand as it is drawn. Fit it again.";
      if (!fitted) localStorage.removeItem(ARM_KEY);
    }
    plot = new Plot(limits);
    $(".rig-dome").append(plot.element);
  }

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
  on(".rig-copy", () => navigator.clipboard.writeText(log.join("\n")).catch(failed));

  return {
    keptFit, started, showState, showTaken,
    /** The newest state; null: none was told yet. */
    get state() { return state; },
  };
}
