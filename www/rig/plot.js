// The arm's range seen from the camera: slant outwards, azimuth around, limits and keep-out cone, light and target.

import { set, svg } from "../svg.js";

/** @typedef {import("../messages.js").Direction} Direction */

const R = 100;

/** @param {[number, number, number]} d */
function at(d) {
  const slant = Math.acos(Math.min(1, Math.max(-1, d[2])));
  const r = R * slant / (Math.PI / 2);
  const flat = Math.hypot(d[0], d[1]) || 1;
  return { x: r * d[0] / flat, y: -r * d[1] / flat };
}

export class Plot {
  #done = svg("g");
  /** @type {unknown} */
  #shown = null;
  #target = svg("circle", { class: "rig-target", r: 5, visibility: "hidden" });
  #light = svg("circle", { class: "rig-light", r: 6, visibility: "hidden" });

  /** @param {number[]} limits azimuth from, to, slant from, to, keep-out; degrees */
  constructor([, , low, high, keepOut]) {
    const reach = Math.max(Math.abs(low), Math.abs(high));
    this.element = svg("svg", { class: "rig-plot", viewBox: "-112 -112 224 224", role: "img", "aria-label": "Position of the light over the object" },
      svg("circle", { class: "rig-out", r: R }),
      svg("circle", { class: "rig-in", r: R * reach / 90 }),
      ...[30, 60].map(s => svg("circle", { class: "rig-ring", r: R * s / 90 })),
      ...[0, 45, 90, 135].map(a => svg("line", { class: "rig-ring", x1: -R, x2: R, transform: `rotate(${a})` })),
      svg("circle", { class: "rig-cone", r: R * keepOut / 90 }, svg("title", {}, `Keep-out cone around the camera, ${keepOut}°`)),
      svg("text", { class: "rig-tick", x: R + 2, y: 4 }, "0°"),
      svg("text", { class: "rig-tick", y: -R - 3, "text-anchor": "middle" }, "90°"),
      this.#done, this.#target, this.#light,
    );
  }

  /**
   * Lights taken stand where they were commanded, with a line to where the mirror sphere showed them.
   * @param {{ light: Direction | null, target: Direction | null, done: { commanded: Direction, measured: Direction | null }[] }} shown
   */
  update({ light, target, done }) {
    const place = (/** @type {SVGElement} */ mark, /** @type {[number, number, number] | null} */ d) => {
      if (!d) return set(mark, { visibility: "hidden" });
      const { x, y } = at(d);
      set(mark, { visibility: "visible", cx: x.toFixed(2), cy: y.toFixed(2) });
    };
    place(this.#light, light);
    place(this.#target, target);
    if (this.#shown !== done) {
      this.#shown = done;
      this.#done.replaceChildren(...done.flatMap(({ commanded, measured }, i) => {
        const { x, y } = at(commanded);
        const seen = measured && at(measured);
        const off = seen ? [svg("line", { class: "rig-measured-line", x1: x, y1: y, x2: seen.x, y2: seen.y }), svg("circle", { class: "rig-measured-mark", cx: seen.x, cy: seen.y, r: 2.2 })] : [];
        return [svg("g", { transform: `translate(${x.toFixed(2)} ${y.toFixed(2)})` }, svg("circle", { class: "rig-done", r: 6.5 }), svg("text", { class: "rig-number", y: 3 }, String(i + 1))), ...off];
      }));
    }
  }
}
