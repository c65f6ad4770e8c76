// The rig view's elements by their selectors, each of the type it must have.

import { find } from "../svg.js";

/** @param {HTMLElement} root */
export function fields(root) {
  const $ = (/** @type {string} */ selector) => find(root, selector, HTMLElement);
  const input = (/** @type {string} */ selector) => find(root, selector, HTMLInputElement);
  return {
    $,
    input,
    select: (/** @type {string} */ selector) => find(root, selector, HTMLSelectElement),
    button: (/** @type {string} */ selector) => find(root, selector, HTMLButtonElement),
    canvas: (/** @type {string} */ selector) => find(root, selector, HTMLCanvasElement),
    number: (/** @type {string} */ selector) => input(selector).valueAsNumber,
    /** A number within its field's limits. @param {string} selector @param {string} name @param {boolean} [whole] */
    typed(selector, name, whole = false) {
      const { valueAsNumber: value, min, max } = input(selector);
      if (value >= Number(min) && value <= Number(max) && (!whole || Number.isInteger(value))) return value;
      throw new Error(`${name}: a ${whole ? "whole " : ""}number from ${min} to ${max} is needed.`);
    },
    on: (/** @type {string} */ selector, /** @type {() => unknown} */ work) => $(selector).addEventListener("click", work),
  };
}
