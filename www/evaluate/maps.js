// What one step gives: the picture, the normals, their error, true and expected, the object under another light and as
// a surface.

import { isAbort } from "../engine.js";
import { newestOnly } from "../store.js";
import { draw, find, html, set } from "../svg.js";
import { angles } from "../dome.js";
import { canSave, saveCanvas, saveFromWorker, waiting } from "./export.js";

/** @typedef {import("./evaluate.js").Panel} Panel */
/** @typedef {import("../messages.js").Picture} Picture */

/** Upper ends of the error map's scale, degrees. */
const SCALES = [10, 20, 30, 45, 90];
/** Width of the surface, pixels. */
const SURFACE = 360;

/**
 * @param {HTMLElement} root
 * @param {Panel} panel
 */
export function mountMaps(root, { page, store, actions }) {
  root.innerHTML = `
    <div class="head"><h2 id="maps-title">What this step gives</h2>
      <label class="row"><span class="note">Error scale</span><select class="scale-choice">${SCALES.map(s => `<option value="${s}">0–${s}°</option>`).join("")}</select></label></div>
    <div class="map-grid"></div>
    <p class="readout" aria-hidden="true"></p>`;
  const grid = find(root, ".map-grid", HTMLElement);
  const readout = find(root, ".readout", HTMLElement);
  const choice = find(root, "select", HTMLSelectElement);

  const image = figure("image", "Picture", "No picture yet");
  const normals = figure("normals", "Normals", "Normals need three lights");
  const errors = figure("errors", "Angular error", "Errors need true normals and three lights");
  const expected = figure("expected", "Predicted error", "What the solver expects of its normals, from three lights on");
  const relit = figure("relit", "Relit", "Drag the sun on the dome once there are normals");
  const surface = figure("surface", "Surface", "");
  grid.append(...[image, normals, errors, expected, relit, surface].map(({ element }) => element));

  const gate = html("option", { value: "gate", disabled: true }, "Gate of the network");
  const taken = html("select", { class: "kind", "aria-label": "Picture shown" }, html("option", { value: "image" }, "Picture"), gate);
  taken.disabled = true;
  image.element.querySelector("b")?.replaceWith(taken);
  taken.addEventListener("change", () => showTaken());

  const bars = [errors, expected].map(({ element }) => {
    const bar = html("canvas", { width: 128, height: 1, "aria-hidden": "true" });
    const top = html("span", { class: "number" });
    element.append(html("div", { class: "scale" }, html("span", { class: "number" }, "0°"), bar, top));
    return { bar, top };
  });

  choice.addEventListener("change", () => actions.rescale(Number(choice.value)));

  /**
   * @param {"image" | "normals" | "errors" | "expected" | "relit" | "surface"} id
   * @param {string} title
   * @param {string} empty
   */
  function figure(id, title, empty) {
    const canvas = html("canvas", { role: "img", width: 1, height: 1, "aria-label": `${title}: none yet` });
    const hint = html("p", { class: "empty" }, empty);
    const note = html("span", { class: "note number" });
    const save = html("button", { type: "button", class: "button small save", hidden: true, "aria-label": `Save ${title.toLowerCase()}` }, "Save PNG");
    save.addEventListener("click", () => {
      // The gate is only here.
      const saved = canvas === image.canvas && taken.value === "gate" ? saveCanvas(store, canvas, "gate.png") : saveFromWorker(page, store, id);
      saved.catch(error => page.problem("The picture could not be saved", error));
    });
    const element = html("figure", { class: `map map-${id}` }, html("div", { class: "frame" }, canvas, hint, save),
      html("figcaption", {}, html("b", {}, title), note));
    /**
     * @param {Picture | null} picture
     * @param {string} text
     */
    const show = (picture, text) => {
      note.textContent = picture ? text : "";
      hint.hidden = Boolean(picture);
      save.hidden = canvas.hidden = !picture;
      if (picture) draw(canvas, picture);
      canvas.setAttribute("aria-label", picture ? `${title}: ${text}` : `${title}: none yet`);
    };
    show(null, "");
    store.watch(["view", "shown", "relit"], state => set(save, { disabled: !canSave(state, id === "surface" ? "glb" : id), title: waiting(state) || null }));
    if (["normals", "errors", "expected"].includes(id)) {
      canvas.addEventListener("pointermove", event => {
        const box = canvas.getBoundingClientRect();
        const scale = Math.min(box.width / canvas.width, box.height / canvas.height);
        const x = (event.clientX - box.left - (box.width - canvas.width * scale) / 2) / scale;
        const y = (event.clientY - box.top - (box.height - canvas.height * scale) / 2) / scale;
        look(Math.floor(x), Math.floor(y));
      });
      canvas.addEventListener("pointerleave", () => { readout.textContent = ""; });
    }
    return { element, canvas, show, hint };
  }

  const look = newestOnly(async (/** @type {number} */ x, /** @type {number} */ y) => {
    const pixel = await page.engine.call("pixel", { x, y }).catch(() => null);
    readout.textContent = !pixel ? "" : `Pixel ${pixel.x}, ${pixel.y}`
      + (pixel.normal ? `: normal ${pixel.normal.map(v => v.toFixed(3)).join(", ")}` : "")
      + (pixel.error === null ? "" : `, error ${pixel.error.toFixed(1)}°`)
      + (pixel.expected === null ? "" : `, predicted ${pixel.expected.toFixed(1)}°`);
  });

  store.watch(["view"], ({ view, shown }) => {
    showTaken();
    normals.show(view?.normals ?? null, `${preview(view)}from ${shown.step} lights${lamps(view?.lampDistance)}${view?.invalid ? `, ${view.invalid} pixels unsolved` : ""}`);
    errors.show(view?.errors ?? null, said("mean", view?.mae) + (view?.unknown ? `, ${view.unknown} pixels without truth` : ""));
    expected.show(view?.expected ?? null, said("mean", view?.expectedMean));
  });

  store.watch(["insight"], ({ insight }) => {
    gate.disabled = taken.disabled = !insight?.gate;
    if (gate.disabled) taken.value = "image";
    showTaken();
  });

  /** The last picture, or what a learned planner believes of it. */
  function showTaken() {
    const { view, insight, runs, shown } = store.state;
    if (taken.value === "gate") return image.show(insight?.gate ?? null, "magenta: not trusted");
    const step = runs.get(shown.planner)?.[shown.step - 1]?.step;
    image.show(view?.image ?? null, step?.name ?? `light ${shown.step}`);
  }

  /** @param {string} what @param {number | null | undefined} degrees */
  function said(what, degrees) {
    return typeof degrees === "number" ? `${preview(store.state.view)}${what} ${degrees.toFixed(2)}°` : "";
  }

  const turn = { yaw: -28, tilt: 18 };
  const integrate = html("button", { type: "button", class: "button small" }, "Show in 3-D");
  const hint = html("span", {}, "The normals, integrated");
  surface.hint.replaceChildren(hint, integrate);
  let wanted = false; // integrating takes up to seconds
  let integrating = new AbortController();
  integrate.addEventListener("click", () => {
    wanted = true;
    drawSurface();
  });
  set(surface.canvas, { role: "application", tabindex: 0, "aria-roledescription": "turnable surface" });

  /** Shows the surface, or the button that makes it; the focus goes from one to the other. @param {Picture | null} picture */
  const showSurface = picture => {
    const held = document.activeElement === integrate || document.activeElement === surface.canvas;
    surface.show(picture, "drag or arrow keys turn it");
    if (held) (picture ? surface.canvas : integrate).focus({ preventScroll: true });
  };

  const drawSurface = newestOnly(async () => {
    const { view } = store.state;
    const whole = Boolean(view?.normals) && view?.solved === 1;
    integrate.hidden = !whole;
    hint.textContent = view?.normals ? "The normals, integrated" : "A surface needs normals";
    integrate.ariaDisabled = String(wanted && whole);
    if (!wanted || !whole) return showSurface(null);
    hint.textContent = "Integrating the normals: seconds for large objects";
    const { signal } = integrating = new AbortController();
    /** @type {Picture | null} */
    let picture = null;
    try {
      picture = await page.engine.call("surface", { ...turn, size: SURFACE }, { signal, patience: 2000 });
    } catch (error) {
      if (isAbort(error)) return; // the view that comes instead draws its own
      page.problem("The surface can't be shown", error);
    }
    if (signal.aborted) return;
    wanted = picture !== null;
    integrate.ariaDisabled = "false";
    hint.textContent = "The normals, integrated";
    showSurface(picture);
  });

  const turnBy = (/** @type {number} */ yaw, /** @type {number} */ tilt) => {
    turn.yaw += yaw;
    turn.tilt = Math.min(Math.max(turn.tilt + tilt, -89), 89);
    drawSurface();
  };
  surface.canvas.addEventListener("pointermove", event => {
    if (event.buttons & 1) turnBy(event.movementX / 2, event.movementY / 2);
  });
  surface.canvas.addEventListener("keydown", event => {
    const arrow = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, -5], ArrowDown: [0, 5] }[event.key];
    if (!arrow) return;
    event.preventDefault();
    turnBy(arrow[0], arrow[1]);
  });

  store.watch(["relit"], ({ relit: picture, sun }) => {
    const { azimuth, slant } = angles(sun);
    relit.show(picture, `light at ${azimuth.toFixed(0)}°, ${slant.toFixed(0)}°`);
  });
  store.watch(["view"], () => {
    integrating.abort();
    showSurface(null);
    drawSurface();
  });
  store.watch(["scale", "catalogue"], async ({ scale, catalogue }) => {
    choice.value = String(scale);
    for (const { top } of bars) top.textContent = `${scale}°`;
    if (!catalogue) return;
    try {
      const colours = await page.engine.call("colours", { width: 128 });
      for (const { bar } of bars) draw(bar, colours);
    } catch (error) {
      page.problem("The scale can't be drawn", error);
    }
  });
}

/** Says that the lamps' nearness was seen. @param {number | null | undefined} distance half widths */
function lamps(distance) {
  return distance ? `, lamps ≈ ${distance.toFixed(0)} half-widths away` : "";
}

/** Says how much of a coarse preview is solved. @param {import("../messages.js").StepView | null} view */
function preview(view) {
  return view && view.solved < 1 ? `${(100 * view.solved).toFixed(0)} % solved: ` : "";
}
