// What to compare, Run and Cancel.

import { stopAt } from "../settings.js";
import { find, html } from "../svg.js";
import { label, swatch } from "./series.js";

/** @typedef {import("./evaluate.js").Panel} Panel */

/** How long a button says that it has copied something. */
const COPIED_MS = 2500;

/**
 * @param {HTMLFormElement} root
 * @param {Panel} panel
 */
export function mountSettings(root, { page, store, actions }) {
  root.innerHTML = `
    <div class="head" style="margin:0"><h2 id="settings-title">Compare</h2><button type="button" class="button small link">Copy link</button></div>
    <div class="run">
      <div class="row"><button type="submit" class="button primary">Run</button><button type="button" class="button cancel" disabled>Cancel</button></div>
      <div class="progress" hidden><progress max="1" aria-label="Run"></progress><span class="what number"></span></div>
    </div>
    <fieldset class="planners"><legend>Planners</legend><div class="list"></div><p class="note withheld" hidden></p></fieldset>
    <fieldset class="solvers"><legend>Solvers</legend><div class="list"></div></fieldset>
    <div class="pair">
      <div class="field"><label for="lights">Lights, T</label><input id="lights" type="number" min="3" max="1000" step="1" required></div>
      <div class="field"><label for="draws">Repetitions</label><input id="draws" type="number" min="1" max="1000" step="1" required></div>
    </div>
    <div class="field"><label for="stop-at">Stop at predicted error below, degrees</label><input id="stop-at" type="number" min="0.1" max="89" step="any" placeholder="never"></div>
    <div class="field"><label for="protocol">Protocol</label><select id="protocol">
      <option value="official">official: full resolution</option><option value="128">128: the papers’ tables</option></select></div>
    <div class="field"><label for="lookup">Image look-up</label><select id="lookup">
      <option value="nearest">nearest photo</option><option value="soft">soft blend of photos</option></select></div>
    <div class="field tau"><label for="tau">Width of the blend, τ in radians</label><input id="tau" type="number" min="0.001" max="10" step="any" value="0.02" required></div>
    <div class="field"><label for="seed">Seed</label><input id="seed" type="number" min="0" max="4294967295" step="1" required></div>`;
  // On a narrow page the form comes after what it changes, for the keyboard as for the eye.
  const narrow = matchMedia("(max-width: 719px)");
  const settle = () => root.parentElement?.querySelector(narrow.matches ? "#maps" : "#object")?.after(root);
  narrow.addEventListener("change", settle);
  settle();
  const planners = find(root, ".planners .list", HTMLElement);
  const withheld = find(root, ".withheld", HTMLElement);
  const solvers = find(root, ".solvers .list", HTMLElement);
  const number = (/** @type {string} */ id) => find(root, `#${id}`, HTMLInputElement);
  const protocol = find(root, "#protocol", HTMLSelectElement);
  const lookup = find(root, "#lookup", HTMLSelectElement);
  const run = find(root, ".primary", HTMLButtonElement);
  const cancel = find(root, ".cancel", HTMLButtonElement);
  const progress = find(root, ".progress", HTMLElement);

  const checked = (/** @type {HTMLElement} */ group) =>
    [...group.querySelectorAll("input")].filter(input => input.checked).map(input => input.value);

  const read = () => {
    const first = planners.querySelector("input");
    first?.setCustomValidity(checked(planners).length ? "" : "Choose at least one planner.");
    const firstSolver = solvers.querySelector("input");
    firstSolver?.setCustomValidity(checked(solvers).length ? "" : "Choose at least one solver.");
    if (!root.checkValidity()) return false;
    const { stop_at: _, ...others } = store.state.settings;
    actions.change({
      ...others, ...stopAt(number("stop-at").valueAsNumber),
      planners: checked(planners), solvers: checked(solvers), lights: [number("lights").valueAsNumber],
      draws: number("draws").valueAsNumber, seed: number("seed").valueAsNumber, protocol: protocol.value === "128" ? "128" : "official",
      lookups: [lookup.value === "soft" ? `soft:${number("tau").valueAsNumber}` : "nearest"],
    });
    return true;
  };
  root.addEventListener("change", read);
  root.addEventListener("submit", event => {
    event.preventDefault();
    if (read()) actions.run();
  });
  cancel.addEventListener("click", () => actions.cancel());
  const link = find(root, ".link", HTMLElement);
  link.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(location.href);
    } catch {
      return page.problem("The link could not be copied", new Error("The browser did not allow it."), "Copy it from the address bar: it always holds the settings.");
    }
    const whole = store.state.source.kind === "sculpture";
    page.announce(whole ? "The link to these settings was copied." : "The link to these settings was copied. Your files are not in it.");
    link.textContent = whole ? "Copied" : "Copied, without your files";
    setTimeout(() => { link.textContent = "Copy link"; }, COPIED_MS);
  });

  store.watch(["catalogue"], ({ catalogue }) => {
    if (!catalogue) return;
    withheld.hidden = !catalogue.withheld;
    withheld.textContent = catalogue.withheld;
    planners.replaceChildren(...catalogue.planners.map(({ name, about }) => planner(name, catalogue, about)));
    solvers.replaceChildren(...catalogue.solvers.map(({ name, label: text, about }) => {
      const id = `solver-${name}`;
      return html("div", { class: "choice" }, html("input", { type: "checkbox", id, value: name, "aria-describedby": `${id}-about` }),
        html("label", { for: id, title: about }, text), html("small", { id: `${id}-about`, class: "hidden" }, about));
    }));
  });
  store.watch(["settings", "catalogue"], ({ settings, catalogue }) => {
    const listed = [...planners.querySelectorAll("input")].map(input => input.value);
    // A link may name planners that the catalogue does not: all, ring:DEGREES.
    if (catalogue) planners.append(...settings.planners.filter(name => !listed.includes(name)).map(name => planner(name, catalogue, "")));
    for (const input of planners.querySelectorAll("input")) input.checked = settings.planners.includes(input.value);
    for (const input of solvers.querySelectorAll("input")) input.checked = settings.solvers.includes(input.value);
    number("lights").value = String(settings.lights[0]);
    number("draws").value = String(settings.draws);
    number("seed").value = String(settings.seed);
    number("stop-at").value = settings.stop_at ? String(settings.stop_at) : "";
    protocol.value = settings.protocol;
    const [kind, tau] = settings.lookups[0].split(":");
    lookup.value = kind;
    if (tau) number("tau").value = tau;
    number("tau").disabled = find(root, ".tau", HTMLElement).hidden = kind !== "soft";
  });
  store.watch(["running", "object"], ({ running, object }) => {
    run.disabled = !object;
    const held = !running && document.activeElement === cancel;
    cancel.disabled = !running;
    if (held) run.focus();
    progress.hidden = !running;
    if (!running) return;
    find(progress, "progress", HTMLProgressElement).value = running.done / Math.max(1, running.total);
    find(progress, ".what", HTMLElement).textContent = running.what ?? `${Math.floor(running.done)} of ${running.total} planners`;
  });
}

/**
 * The choice of a planner.
 * @param {string} name
 * @param {import("../messages.js").Catalogue} catalogue
 * @param {string} about
 */
function planner(name, catalogue, about) {
  const id = `planner-${name}`;
  return html("div", { class: "choice" }, html("input", { type: "checkbox", id, value: name, "aria-describedby": `${id}-about` }),
    swatch(name), html("label", { for: id, title: about }, label(catalogue, name)), html("small", { id: `${id}-about`, class: "hidden" }, about));
}
