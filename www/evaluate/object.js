// The object: what it is, and how to open another.

import { chosenFiles, droppedFiles } from "../folder.js";
import { BUILT_IN } from "../settings.js";
import { find, html } from "../svg.js";

/** @typedef {import("./evaluate.js").Panel} Panel */
/** @typedef {import("../messages.js").NamedFile} NamedFile */

/**
 * @param {HTMLElement} root
 * @param {Panel} panel
 */
export function mountObject(root, { page, store, actions }) {
  root.innerHTML = `
    <div>
      <h2 id="object-title">Opening…</h2>
      <p class="facts"></p>
    </div>
    <div class="actions">
      <label class="row among" hidden><span class="label">Object</span><select></select></label>
      <button type="button" class="button built-in">Built-in object</button>
      <button type="button" class="button open-folder">Open folder…</button>
      <button type="button" class="button open-zip">Open .zip…</button>
      <input type="file" class="folder-input" webkitdirectory multiple hidden aria-label="DiLiGenT folder">
      <input type="file" class="zip-input" accept=".zip,application/zip" hidden aria-label="Zip archive">
    </div>
    <p class="note hint">Or drop a DiLiGenT object, a folder of them or a .zip anywhere on this page. Nothing leaves this machine.</p>
    <div class="progress" hidden>
      <progress max="1" aria-label="Opening the object"></progress>
      <span class="row"><span class="what number"></span><button type="button" class="button small cancel">Cancel</button></span>
    </div>`;
  const title = find(root, "h2", HTMLElement);
  const facts = find(root, ".facts", HTMLElement);
  const among = find(root, ".among", HTMLElement);
  const choice = find(among, "select", HTMLSelectElement);
  const progress = find(root, ".progress", HTMLElement);
  const folderInput = find(root, ".folder-input", HTMLInputElement);
  const zipInput = find(root, ".zip-input", HTMLInputElement);

  /** @param {NamedFile[]} files */
  const openFiles = files => { if (files.length) actions.open({ kind: "files", files, object: null }); };

  find(root, ".built-in", HTMLElement).addEventListener("click", () => {
    const { source } = store.state;
    actions.open(source.kind === "built-in" ? source : BUILT_IN);
  });
  find(root, ".open-folder", HTMLElement).addEventListener("click", () => folderInput.click());
  find(root, ".open-zip", HTMLElement).addEventListener("click", () => zipInput.click());
  find(root, ".cancel", HTMLElement).addEventListener("click", () => actions.cancelOpening());
  for (const input of [folderInput, zipInput]) {
    input.addEventListener("change", () => {
      if (input.files) openFiles(chosenFiles(input.files));
      input.value = ""; // so that the same folder can be chosen again
    });
  }
  choice.addEventListener("change", () => {
    const { source } = store.state;
    if (source.kind === "files") actions.open({ ...source, object: choice.value });
  });

  let depth = 0; // dragenter and dragleave come for every element that is crossed
  const target = (/** @type {boolean} */ on) => document.body.classList.toggle("drop-target", on);
  window.addEventListener("dragenter", () => { depth += 1; target(true); });
  window.addEventListener("dragleave", () => { depth -= 1; if (depth <= 0) target(false); });
  window.addEventListener("dragover", event => event.preventDefault());
  window.addEventListener("drop", event => {
    event.preventDefault();
    depth = 0;
    target(false);
    if (!event.dataTransfer) return;
    droppedFiles(event.dataTransfer).then(openFiles)
      .catch(error => page.problem("What was dropped can't be read", error));
  });

  store.watch(["object", "stack", "source"], ({ object, stack, source }) => {
    if (!object) return;
    title.textContent = object.name;
    const parts = [
      [String(object.images), "images"], [`${object.width}×${object.height}`, "pixels"], [object.pixels.toLocaleString("en"), "on the object"],
      [String(object.bits), "bit"], ...(stack ? [[`${stack.reach.toFixed(0)}°`, "largest slant"]] : []),
      object.truth ? ["true normals", "known"] : ["no", "true normals: errors can't be shown"],
    ];
    facts.replaceChildren(...parts.map(([value, what]) => html("span", {}, html("b", {}, value), ` ${what}`)));
    if (source.kind === "built-in") facts.append(html("span", {}, "rendered in this page"));
    for (const note of object.notes) facts.append(html("span", {}, note));
    among.hidden = object.objects.length < 2;
    choice.replaceChildren(...object.objects.map(name => html("option", { selected: name === object.name }, name)));
  });
  store.watch(["opening"], ({ opening }) => {
    progress.hidden = !opening;
    root.setAttribute("aria-busy", String(Boolean(opening)));
    if (!opening) return;
    find(progress, "progress", HTMLProgressElement).value = opening.done / Math.max(1, opening.total);
    find(progress, ".what", HTMLElement).textContent = opening.total > 1 ? `${opening.what} ${opening.done} of ${opening.total}` : opening.what;
  });
}
