// The dome with the lights of the run that is looked at, and the way back through its steps.

import { angles, Dome } from "../dome.js";
import { newestOnly } from "../store.js";
import { download, draw, find, html, set } from "../svg.js";
import { errorText, label, seriesColour, solverLabel } from "./series.js";

/** @typedef {import("./evaluate.js").Panel} Panel */
/** @typedef {import("../messages.js").Direction} Direction */

/** Pixels of the picture beside a candidate's direction. */
const PHOTO = 112;
/** No photo is larger. */
const WHOLE = 4096;

/**
 * @param {HTMLElement} root
 * @param {Panel} panel
 */
export function mountDome(root, { page, store, actions }) {
  root.innerHTML = `
    <div class="head">
      <h2 id="dome-title">Lights, step by step</h2>
      <div class="shown">
        <select class="planner" aria-label="Planner shown"></select>
        <select class="solver" aria-label="Solver shown"></select>
      </div>
    </div>
    <p class="note about"></p>
    <div class="host"></div>
    <div class="dome-tools" role="group" aria-label="View of the dome">
      <button type="button" class="button small" data-turn="-1 0" aria-label="Turn left">←</button>
      <button type="button" class="button small" data-turn="1 0" aria-label="Turn right">→</button>
      <button type="button" class="button small" data-turn="0 1" aria-label="Tilt down">↓</button>
      <button type="button" class="button small" data-turn="0 -1" aria-label="Tilt up">↑</button>
      <button type="button" class="button small" data-look="default">Side</button>
      <button type="button" class="button small" data-look="camera">Camera’s view</button>
      <button type="button" class="button small save">Save SVG</button>
    </div>
    <div class="step">
      <output for="scrub">No run yet</output>
      <input id="scrub" type="range" min="1" max="1" value="1" step="1" aria-label="Step of the run" disabled>
      <button type="button" class="button small play" aria-label="Play the steps" disabled>Play</button>
    </div>
    <p class="caption"></p>
    <p class="caption thought"></p>
    <ol class="strip" aria-label="Pictures taken, in order" tabindex="0"></ol>`;
  const host = find(root, ".host", HTMLElement);
  const about = find(root, ".about", HTMLElement);
  const planner = find(root, ".planner", HTMLSelectElement);
  const solver = find(root, ".solver", HTMLSelectElement);
  const scrub = find(root, "#scrub", HTMLInputElement);
  const output = find(root, "output", HTMLOutputElement);
  const caption = find(root, ".caption", HTMLElement);
  const thought = find(root, ".thought", HTMLElement);
  const strip = find(root, ".strip", HTMLElement);
  const play = find(root, ".play", HTMLButtonElement);
  const tip = html("div", { class: "dome-tip", hidden: true });

  const dome = new Dome(host, {
    onSun: direction => actions.relight(direction),
    onLight: light => actions.show({ step: light + 1 }),
    onCandidate: candidate => point(candidate),
  });
  host.append(tip);

  const photo = newestOnly(async (/** @type {number} */ index) => {
    try {
      const picture = await page.engine.call("photo", { index, size: PHOTO });
      const canvas = tip.querySelector("canvas");
      if (canvas && tip.dataset.index === String(index)) draw(canvas, picture);
    } catch (error) {
      page.problem("This picture can't be shown", error);
    }
  });

  /** @param {number | null} candidate */
  function point(candidate) {
    const { stack, runs, shown } = store.state;
    tip.hidden = candidate === null || !stack;
    if (candidate === null || !stack) return;
    const { x, y } = dome.locate(candidate);
    tip.style.cssText = `left:${100 * x}%; top:${100 * y}%; transform: translate(${x > 0.55 ? "calc(-100% - 10px)" : "10px"}, ${y > 0.5 ? "calc(-100% - 8px)" : "8px"})`;
    const used = (runs.get(shown.planner) ?? []).findIndex(({ step }) => step.image === candidate);
    const lines = [stack.names[candidate], `${candidate + 1} of ${stack.lights.length}: ${spoken(stack.lights[candidate])}`, used < 0 ? "not used by this run" : `light ${used + 1} of this run`];
    tip.dataset.index = String(candidate);
    tip.replaceChildren(html("canvas", { width: 1, height: 1 }), html("b", {}, lines[0]), html("span", {}, lines[1]), html("span", {}, lines[2]));
    page.announce(lines.join(", "));
    photo(candidate);
  }

  planner.addEventListener("change", () => actions.show({ planner: planner.value }));
  solver.addEventListener("change", () => actions.show({ solver: solver.value }));
  scrub.addEventListener("input", () => actions.show({ step: scrub.valueAsNumber }));
  for (const button of root.querySelectorAll("button[data-turn]")) {
    const [yaw, tilt] = (button.getAttribute("data-turn") ?? "").split(" ").map(Number);
    button.addEventListener("click", () => dome.turn(yaw * Math.PI / 12, tilt * Math.PI / 18));
  }
  for (const button of root.querySelectorAll("button[data-look]")) {
    button.addEventListener("click", () => dome.look(button.getAttribute("data-look") === "camera" ? "camera" : "default"));
  }
  find(root, ".save", HTMLElement).addEventListener("click", () => {
    const { object, shown } = store.state;
    download(new Blob([dome.toSvg()], { type: "image/svg+xml" }), `${object?.name ?? "dome"}-${shown.planner}-lights.svg`);
  });

  let timer = 0;
  const stop = () => {
    clearInterval(timer);
    timer = 0;
    play.textContent = "Play";
    play.setAttribute("aria-label", "Play the steps");
  };
  play.addEventListener("click", () => {
    if (timer) return stop();
    play.textContent = "Pause";
    play.setAttribute("aria-label", "Pause");
    if (store.state.shown.step >= Number(scrub.max)) actions.show({ step: 1 });
    timer = window.setInterval(() => {
      const { step } = store.state.shown;
      if (step >= Number(scrub.max)) stop();
      else actions.show({ step: step + 1 });
    }, 700);
  });

  store.watch(["ran", "catalogue"], ({ ran, catalogue, shown }) => {
    const names = ran?.planners ?? [];
    planner.replaceChildren(...names.map(name => html("option", { value: name, selected: name === shown.planner }, label(catalogue, name))));
    solver.replaceChildren(...(ran?.solvers ?? []).map(name => html("option", { value: name, selected: name === shown.solver }, solverLabel(catalogue, name))));
    solver.hidden = (ran?.solvers.length ?? 0) < 2;
  });
  let bare = true;
  store.watch(["object"], () => {
    bare = true;
    dome.setObject(null);
  });
  store.watch(["stack"], ({ stack }) => {
    if (stack && bare) showFirst(stack);
    dome.update({ candidates: stack?.lights ?? [], reach: stack?.reach ?? 90, lights: [], current: 0, sun: null });
    tip.hidden = true;
  });
  store.watch(["shown", "catalogue"], ({ shown, catalogue }) => {
    const found = catalogue?.planners.find(p => p.name === shown.planner);
    about.textContent = found ? `${found.label}: ${found.about}.` : "";
  });
  store.watch(["runs", "shown"], ({ runs, shown, sun, object }) => {
    planner.value = shown.planner;
    solver.value = shown.solver;
    root.setAttribute("style", seriesColour(shown.planner));
    const steps = runs.get(shown.planner) ?? [];
    const lights = steps.map(({ step }, i) => ({ used: step.used, requested: step.requested, label: steps.length <= 30 ? String(i + 1) : "" }));
    dome.update({ lights, current: shown.step, ...(steps.length ? { sun } : {}) });
    scrub.disabled = play.disabled = steps.length < 2;
    scrub.max = String(Math.max(1, steps.length));
    scrub.value = String(shown.step);
    drawStrip(steps, shown.step);
    const now = steps[shown.step - 1];
    output.textContent = now ? `Step ${shown.step} of ${steps.length}` : "No run yet";
    caption.replaceChildren(...(now ? describe(now, shown.solver, object?.truth !== false, shown.step) : []));
    scrub.setAttribute("aria-valuetext", now ? caption.textContent ?? "" : "no run yet");
  });
  store.watch(["insight"], ({ insight }) => {
    if (!insight) return thought.replaceChildren();
    const sorted = insight.milliseconds.toSorted((a, b) => a - b);
    thought.replaceChildren("The network next asks for ", html("b", {}, spoken(insight.next)),
      `; a step takes it ${sorted[sorted.length >> 1].toFixed(0)} ms (median).`);
  });
  store.watch(["sun"], ({ sun, view }) => { if (view) dome.update({ sun }); });
  store.watch(["relit", "view"], ({ relit, view }) => {
    const picture = relit ?? view?.image;
    if (!picture) return;
    bare = false;
    dome.setObject(picture);
  });

  /** Shows the object's first photo until a run has one. @param {import("../messages.js").StackInfo} stack */
  async function showFirst(stack) {
    const awaited = () => bare && store.state.stack === stack;
    try {
      const picture = await page.engine.call("photo", { index: 0, size: WHOLE });
      if (awaited()) dome.setObject(picture);
    } catch (error) {
      if (awaited()) page.problem("The object's picture can't be shown", error);
    }
  }

  /**
   * @param {import("../messages.js").RunStep[]} steps
   * @param {number} current
   */
  function drawStrip(steps, current) {
    while (strip.children.length > steps.length) strip.lastElementChild?.remove();
    steps.forEach((step, i) => {
      let item = strip.children[i];
      if (!item) {
        const button = html("button", { type: "button" }, html("canvas", { width: 1, height: 1 }), html("span", { class: "number" }));
        button.addEventListener("click", () => actions.show({ step: i + 1 }));
        item = html("li", {}, button);
        strip.append(item);
      }
      const button = find(item, "button", HTMLButtonElement);
      if (drawn.get(item) !== step.thumbnail) {
        drawn.set(item, step.thumbnail);
        draw(find(item, "canvas", HTMLCanvasElement), step.thumbnail);
      }
      const error = step.errors[store.state.shown.solver];
      const text = typeof error === "number" ? errorText(error, store.state.object?.truth !== false, 1) : `${i + 1}`;
      find(item, "span", HTMLElement).textContent = text;
      set(button, {
        "aria-label": `${text}, light ${i + 1}: ${spoken(step.step.used)}${step.step.name ? `, image ${step.step.name}` : ""}`,
        "aria-current": i + 1 === current ? "step" : null,
        class: i + 1 > current ? "future" : null,
      });
    });
  }
}

/** Which thumbnail a place of the strip shows. @type {WeakMap<Element, import("../messages.js").Picture>} */
const drawn = new WeakMap();

/** @param {Direction} direction */
function spoken(direction) {
  const { azimuth, slant } = angles(direction);
  return slant < 0.5 ? "from the camera" : `azimuth ${azimuth.toFixed(0)}°, slant ${slant.toFixed(0)}°`;
}

/**
 * @param {import("../messages.js").RunStep} taken
 * @param {string} solver
 * @param {boolean} known whether there are true normals
 * @param {number} count lights so far
 * @returns {(Node | string)[]}
 */
function describe({ step, errors }, solver, known, count) {
  const parts = [html("b", {}, spoken(step.used)), step.name ? `, image ${step.name}` : ""];
  if (step.effective > 1.01) parts.push(`, blended from ${step.effective.toFixed(1)} photos`);
  if (step.deviation > 0.05) parts.push(`; asked for ${spoken(step.requested)}, ${step.deviation.toFixed(1)}° away`);
  parts.push(". ");
  const error = errors[solver];
  if (typeof error === "number") parts.push(html("b", {}, `${known ? "Mean error" : "Predicted mean error"} ${errorText(error, known)}.`));
  else if (count < 3) parts.push("A normal needs three lights.");
  return parts;
}
