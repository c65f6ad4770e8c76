// The object: what it is, and how to open another.

import { chosenFiles, droppedFiles } from "../folder.js";
import { BUILT_IN } from "../settings.js";
import { find, html } from "../svg.js";

/** @typedef {import("./evaluate.js").Panel} Panel */
/** @typedef {import("../messages.js").NamedFile} NamedFile */

/** Objects that are a part of another, as people see them. @type {Record<string, string>} */
const VARIANTS = { bear76: "bear76: without its bad first 20 images" };
const MESH = /\.(obj|ply|stl)$/i;
const ARCHIVE = /\.zip$/i;
const PICTURE = /\.(png|jpe?g|tiff?|bmp|webp|gif|heic|avif|dng|cr[23]|nef|arw)$/i;
/** Every object has one of these. */
const LIST = /(^|\/)(filenames|light_directions|light_intensities)\.txt$/;
const NEEDED = "Expected is a DiLiGenT object: a folder (or a .zip of it) with the images as PNG, filenames.txt, mask.png, "
  + "and light_directions.txt, which says where the light was in each image.";

/**
 * @param {HTMLElement} root
 * @param {Panel} panel
 */
export function mountObject(root, { page, store, actions }) {
  root.innerHTML = `
    <div class="what">
      <h2 id="object-title">Opening…</h2>
      <p class="facts"></p>
      <ul class="note notes" aria-label="Notes on the files"></ul>
    </div>
    <div class="actions">
      <label class="row among" hidden><span class="label">Object</span><select></select></label>
      <button type="button" class="button render">Render an object…</button>
      <button type="button" class="button open-folder">Open folder…</button>
      <button type="button" class="button open-file">Open .zip…</button>
      <input type="file" class="folder-input" webkitdirectory multiple hidden aria-label="DiLiGenT folder">
      <input type="file" class="file-input" accept=".zip,application/zip" hidden aria-label="Zip archive">
      <input type="file" class="mesh-input" accept=".obj,.ply,.stl" hidden aria-label="Mesh">
    </div>
    <p class="note hint">Or drop a DiLiGenT object, a folder of them, a .zip or a mesh anywhere on this page. Nothing leaves this machine.</p>
    <div class="progress" hidden>
      <progress max="1" aria-label="Opening the object"></progress>
      <span class="row"><span class="what number"></span><button type="button" class="button small cancel">Cancel</button></span>
    </div>
    <dialog aria-labelledby="render-title"><form method="dialog">
      <h2 id="render-title">Render an object</h2>
      <p class="note">Photographed in this page under 100 lights, with shadows and inter-reflection; its true normals are known.</p>
      <div class="field"><label for="family">Shape</label><select id="family"></select></div>
      <div class="pair">
        <div class="field"><label for="shape-seed">Seed</label><input id="shape-seed" type="number" min="0" max="4294967295" step="1" required></div>
        <div class="field"><label for="material">Material</label><select id="material"></select></div>
      </div>
      <div class="row buttons">
        <button type="submit" class="button primary" value="sculpture">Render</button>
        <button type="button" class="button own-mesh">Own mesh…</button>
        <button type="button" class="button first">Built-in object</button>
        <button type="submit" class="button" value="" formnovalidate>Close</button>
      </div>
    </form></dialog>`;
  const title = find(root, "h2", HTMLElement);
  const facts = find(root, ".facts", HTMLElement);
  const notes = find(root, ".notes", HTMLElement);
  const among = find(root, ".among", HTMLElement);
  const choice = find(among, "select", HTMLSelectElement);
  const progress = find(root, ".progress", HTMLElement);
  const input = (/** @type {string} */ name) => find(root, `.${name}-input`, HTMLInputElement);
  const dialog = find(root, "dialog", HTMLDialogElement);
  const family = find(root, "#family", HTMLSelectElement);
  const seed = find(root, "#shape-seed", HTMLInputElement);
  const material = find(root, "#material", HTMLSelectElement);

  /** @param {NamedFile[]} files */
  const openFiles = files => {
    const wrong = refusal(files);
    if (wrong) page.problem("This object can't be opened", new Error(wrong), store.state.object ? `${NEEDED} The object shown stays.` : NEEDED);
    else if (MESH.test(files[0].path) && files.length === 1) openMesh(files[0].file);
    else actions.open({ kind: "files", files, object: null });
  };
  /** @param {File} file */
  const openMesh = file => actions.open({ kind: "mesh", file, material: material.value || BUILT_IN.material });

  const cancel = find(root, ".cancel", HTMLElement);
  /** What the focus goes back to when there is nothing to cancel any more. */
  let opener = find(root, ".render", HTMLElement);
  for (const button of root.querySelectorAll(".actions button")) {
    button.addEventListener("click", () => { opener = /** @type {HTMLElement} */ (button); });
  }
  find(root, ".render", HTMLElement).addEventListener("click", () => dialog.showModal());
  find(root, ".open-folder", HTMLElement).addEventListener("click", () => input("folder").click());
  find(root, ".open-file", HTMLElement).addEventListener("click", () => input("file").click());
  cancel.addEventListener("click", () => actions.cancelOpening());
  find(root, ".own-mesh", HTMLElement).addEventListener("click", () => input("mesh").click());
  find(root, ".first", HTMLElement).addEventListener("click", () => {
    dialog.close("");
    actions.open(BUILT_IN);
  });
  dialog.addEventListener("close", () => {
    if (dialog.returnValue !== "sculpture") return;
    actions.open({ kind: "sculpture", family: family.value, seed: seed.valueAsNumber, material: material.value });
  });
  for (const name of ["folder", "file", "mesh"]) {
    input(name).addEventListener("change", () => {
      const { files } = input(name);
      dialog.close("");
      if (files) openFiles(chosenFiles(files));
      input(name).value = ""; // so that the same folder can be chosen again
    });
  }
  choice.addEventListener("change", () => {
    const { source } = store.state;
    opener = choice;
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
    if (!event.dataTransfer?.types.includes("Files")) return;
    droppedFiles(event.dataTransfer).then(openFiles)
      .catch(error => page.problem("What was dropped can't be read", error));
  });

  store.watch(["catalogue", "source"], ({ catalogue, source }) => {
    if (!catalogue) return;
    const shape = source.kind === "sculpture" ? source : BUILT_IN;
    family.replaceChildren(...catalogue.families.map(([name, about]) => html("option", { value: name, selected: name === shape.family }, `${name}: ${about}`)));
    material.replaceChildren(...catalogue.materials.map(name => html("option", { selected: name === shape.material }, name)));
    seed.value = String(shape.seed);
  });
  store.watch(["object", "stack", "source"], ({ object, stack, source }) => {
    if (!object) return;
    title.textContent = object.name;
    const parts = [
      [String(object.images), "images"], [`${object.width}×${object.height}`, "pixels"], [object.pixels.toLocaleString("en"), "on the object"],
      [String(object.bits), "bit"], ...(stack ? [[`${stack.reach.toFixed(0)}°`, "largest slant"]] : []),
      ["true normals", object.truth ? "known" : "unknown"],
    ];
    facts.replaceChildren(...parts.map(([value, what]) => html("span", {}, html("b", {}, value), ` ${what}`)));
    if (source.kind !== "files") facts.append(html("span", {}, html("b", {}, source.material), " rendered in this page"));
    notes.replaceChildren(...object.notes.map(note => html("li", {}, note)));
    among.hidden = object.objects.length < 2;
    choice.replaceChildren(...object.objects.map(name => html("option", { value: name, selected: name === object.name }, VARIANTS[name] ?? name)));
  });
  store.watch(["object", "opening"], ({ object, opening, catalogue }) => {
    const held = !opening && document.activeElement === cancel;
    progress.hidden = !opening;
    if (held) opener.focus();
    root.setAttribute("aria-busy", String(Boolean(opening)));
    if (!object) {
      title.textContent = opening || !catalogue ? "Opening…" : "No object is open";
      for (const list of [facts, notes]) list.replaceChildren();
      among.hidden = true;
    }
    if (!opening) {
      choice.value = object?.name ?? "";
      return;
    }
    find(progress, "progress", HTMLProgressElement).value = opening.done / Math.max(1, opening.total);
    find(progress, ".what", HTMLElement).textContent = opening.total > 1 ? `${opening.what} ${opening.done} of ${opening.total}` : opening.what;
  });
}

/** Why these files can't be an object; null if they may be one. @param {NamedFile[]} files */
function refusal(files) {
  const count = (/** @type {RegExp} */ kind) => files.filter(({ path }) => kind.test(path)).length;
  const [archives, meshes, pictures] = [ARCHIVE, MESH, PICTURE].map(count);
  if (!files.length) return "There are no files in it.";
  if (count(LIST) || files.length === 1 && archives + meshes === 1) return null;
  if (archives + meshes) return `Open one archive or mesh at a time, and nothing beside it: these are ${files.length} files.`;
  const what = pictures ? [pictures, "picture"] : [files.length, "file"];
  return `${what[0]} ${what[1]}${what[0] === 1 ? "" : "s"}, but no light directions: light_directions.txt is missing.`;
}
