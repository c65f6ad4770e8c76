// The picture to draw the mask on, and to mark the mirror sphere on. Pixels are counted in the whole picture; the core
// fills, strokes and fits.

import { draw, find, html, set, svg } from "../svg.js";

/** @typedef {import("./messages.js").Sketch} Sketch */
/** @typedef {import("./messages.js").Outline} Outline */

const percent = (/** @type {number} */ v) => `${(100 * v).toFixed(1)} %`;

export class MaskPanel {
  /** @type {Sketch | null} */
  #sketch = null;
  /** Corners of the polygon, or points on the sphere's rim. @type {[number, number][]} */
  #points = [];
  /** @type {Outline | null} */
  #outline = null;
  /** @type {[number, number] | null} */
  #last = null;
  #busy = Promise.resolve();

  /**
   * @param {import("./client.js").Client} client
   * @param {(error: unknown) => void} failed
   */
  constructor(client, failed) {
    this.client = client;
    this.failed = failed;
    this.element = html("div", { class: "rig-mask", hidden: true });
    this.element.innerHTML = `
      <div class="rig-stage"><canvas class="rig-preview" width="8" height="8" role="img" aria-label="Picture with the object's mask"></canvas></div>
      <fieldset class="row"><legend class="hidden">Tool</legend>
        <label><input type="radio" name="rig-tool" value="polygon" checked> Polygon</label>
        <label><input type="radio" name="rig-tool" value="brush"> Brush</label>
        <label><input type="radio" name="rig-tool" value="erase"> Erase</label>
        <label><input type="radio" name="rig-tool" value="sphere"> Sphere’s rim</label>
        <label>Brush <input type="range" class="rig-brush" min="2" max="60" value="14"></label>
        <button type="button" class="button small rig-close">Close polygon</button>
        <button type="button" class="button small rig-clear">Clear</button>
      </fieldset>
      <div class="row"><label>Threshold <input type="range" class="rig-level" min="-12" max="0" step="0.1" value="-4"></label><button type="button" class="button small rig-otsu">Mask by threshold</button></div>
      <p class="rig-sketch note" role="status"></p>
      <div class="rig-sphere-tools" hidden>
        <div class="row"><button type="button" class="button small rig-find">Find the sphere</button>
          <label>x <input type="number" class="rig-cx" step="0.1"></label><label>y <input type="number" class="rig-cy" step="0.1"></label><label>radius <input type="number" class="rig-cr" step="0.1" min="1"></label>
          <button type="button" class="button small rig-measure">Measure the light</button></div>
        <p class="rig-measured note" role="status"></p>
      </div>`;
    this.overlay = svg("svg", { class: "rig-over", "aria-hidden": "true" });
    find(this.element, ".rig-stage", HTMLElement).append(this.overlay);
    this.#wire();
  }

  /** @param {string} selector */
  #input(selector) {
    return find(this.element, selector, HTMLInputElement);
  }

  get #tool() {
    return this.#input("input[name=rig-tool]:checked").value;
  }

  /** Outline of the mirror sphere; null where none is marked. */
  get outline() {
    return this.#outline;
  }

  get pixels() {
    return this.#sketch?.pixels ?? 0;
  }

  /** @param {boolean} shown */
  set sphere(shown) {
    find(this.element, ".rig-sphere-tools", HTMLElement).hidden = !shown;
    if (!shown) this.#mark(null);
  }

  /** @param {Sketch} sketch */
  show(sketch) {
    this.element.hidden = false;
    this.#sketch = sketch;
    draw(find(this.element, ".rig-preview", HTMLCanvasElement), sketch.picture);
    set(this.overlay, { viewBox: `0 0 ${sketch.width} ${sketch.height}` });
    if (sketch.level !== null) this.#input(".rig-level").value = String(Math.log2(sketch.level));
    const { quality } = sketch;
    const size = `${sketch.width} × ${sketch.height} pixels. `;
    find(this.element, ".rig-sketch", HTMLElement).textContent = size + (quality
      ? `Mask ${sketch.pixels} pixels; saturated ${percent(quality.saturated)}, dark ${percent(quality.dark)}, noise ${percent(quality.noise)}.`
      : "Mark the object: draw around it, or take what is brighter than a threshold.");
    this.#over();
  }

  /** One after the other, so that strokes keep their order. @param {import("./messages.js").Stroke} stroke */
  #draw(stroke) {
    this.#busy = this.#busy.then(async () => this.show(await this.client.call("draw", { stroke }))).catch(this.failed);
  }

  /** @param {Outline | null} outline */
  #mark(outline) {
    this.#outline = outline;
    const value = (/** @type {number | undefined} */ v) => v === undefined ? "" : v.toFixed(1);
    this.#input(".rig-cx").value = value(outline?.x);
    this.#input(".rig-cy").value = value(outline?.y);
    this.#input(".rig-cr").value = value(outline?.radius);
    this.#over();
  }

  #over() {
    const width = this.#sketch?.width ?? 100;
    const dot = width / 120;
    const points = this.#points.map(([x, y]) => svg("circle", { cx: x, cy: y, r: dot }));
    const line = this.#points.length > 1 ? [svg("polyline", { points: this.#points.map(p => p.join(",")).join(" "), "stroke-width": dot / 2 })] : [];
    const o = this.#outline;
    const circle = o ? [svg("circle", { class: "rim", cx: o.x, cy: o.y, r: o.radius, "stroke-width": dot / 2 })] : [];
    this.overlay.replaceChildren(...line, ...points, ...circle);
  }

  /** @param {MouseEvent} event @returns {[number, number]} */
  #at(event) {
    const box = this.overlay.getBoundingClientRect();
    const { width, height } = this.#sketch ?? { width: 1, height: 1 };
    return [(event.clientX - box.left) / box.width * width, (event.clientY - box.top) / box.height * height];
  }

  #closePolygon() {
    if (this.#points.length >= 3) this.#draw({ kind: "polygon", corners: this.#points.flat(), add: true });
    this.#points = [];
    this.#over();
  }

  async #rim() {
    if (this.#points.length < 3) return;
    try {
      this.#mark(await this.client.call("fitOutline", { points: this.#points.flat() }));
    } catch (error) {
      this.failed(error);
    }
  }

  #wire() {
    const brush = () => {
      const { width } = this.#sketch ?? { width: 1 };
      const shown = this.overlay.getBoundingClientRect().width || 1;
      return Number(this.#input(".rig-brush").value) * width / shown;
    };
    this.overlay.addEventListener("pointerdown", event => {
      if (!this.#sketch) return;
      event.preventDefault();
      const at = this.#at(event);
      if (this.#tool === "brush" || this.#tool === "erase") {
        this.overlay.setPointerCapture(event.pointerId);
        this.#last = at;
        this.#draw({ kind: "stroke", from: at, to: at, radius: brush(), add: this.#tool === "brush" });
        return;
      }
      this.#points.push(at);
      this.#over();
      if (this.#tool === "sphere") void this.#rim();
    });
    this.overlay.addEventListener("pointermove", event => {
      if (!this.#last) return;
      const at = this.#at(event);
      this.#draw({ kind: "stroke", from: this.#last, to: at, radius: brush(), add: this.#tool === "brush" });
      this.#last = at;
    });
    for (const end of ["pointerup", "pointercancel"]) this.overlay.addEventListener(end, () => { this.#last = null; });
    this.overlay.addEventListener("dblclick", () => this.#tool === "polygon" && this.#closePolygon());
    for (const tool of this.element.querySelectorAll("input[name=rig-tool]")) {
      tool.addEventListener("change", () => { this.#points = []; this.#over(); });
    }
    const click = (/** @type {string} */ selector, /** @type {() => unknown} */ work) => find(this.element, selector, HTMLElement).addEventListener("click", work);
    click(".rig-close", () => this.#tool === "sphere" ? this.#rim() : this.#closePolygon());
    click(".rig-clear", () => { this.#points = []; this.#draw({ kind: "clear" }); });
    click(".rig-otsu", () => this.#draw({ kind: "threshold", level: null }));
    this.#input(".rig-level").addEventListener("change", () => this.#draw({ kind: "threshold", level: 2 ** Number(this.#input(".rig-level").value) }));
    click(".rig-find", async () => {
      try {
        this.#mark(await this.client.call("findOutline", {}));
      } catch (error) {
        this.failed(error);
      }
    });
    for (const field of [".rig-cx", ".rig-cy", ".rig-cr"]) {
      this.#input(field).addEventListener("change", () => {
        const [x, y, radius] = [".rig-cx", ".rig-cy", ".rig-cr"].map(name => this.#input(name).valueAsNumber);
        if ([x, y, radius].every(Number.isFinite) && radius > 0) this.#mark({ x, y, radius });
      });
    }
    click(".rig-measure", async () => {
      try {
        if (!this.#outline) throw new Error("Mark the sphere first: find it in a picture with room light, click on its rim, or type its centre and radius.");
        const m = await this.client.call("measure", { outline: this.#outline });
        find(this.element, ".rig-measured", HTMLElement).textContent = `Light at azimuth ${m.azimuth.toFixed(1)}°, slant ${m.slant.toFixed(1)}°, ±${m.uncertainty.toFixed(2)}°.`;
      } catch (error) {
        this.failed(error);
      }
    });
  }
}
