// The capture: its settings, beginning and pausing, and where its session is stored.

import { download, html } from "../svg.js";
import { IN_PIECES } from "../solvers.js";
import { chooseFolder } from "./camera.js";
import { explain } from "./port.js";

/** How the simulated arm stands when it stands askew: azimuth, slant, tilt about x and y; degrees. */
const ASKEW = /** @type {[number, number, number, number]} */ ([4, -2, 1.5, -1]);

/**
 * @param {import("./rig.js").Panel} panel
 * @param {ReturnType<typeof import("./camera_panel.js").mountCamera>} camera
 */
export function mountCapture({ page, client, fields, say, failed }, camera) {
  const { $, input, select, button, number, typed, on } = fields;
  /** @type {import("./messages.js").Stored | null} */
  let stored = null;
  /** The session's folder before the reload: the browser asks on a click whether it may be used again. @type {FileSystemDirectoryHandle | null} */
  let former = null;

  /** @returns {import("./messages.js").CaptureSettings} */
  function settings() {
    const sim = select(".rig-camera").value === "sim";
    const ball = sim ? input(".rig-ball").checked : input(".rig-mirror").checked;
    return {
      camera: sim ? "sim" : "frames",
      object: sim ? select(".rig-object").value : input(".rig-name").value.trim() || "object",
      material: "lambert:0.8",
      size: 96,
      planner: select(".rig-planner").value,
      solver: select(".rig-solver").value,
      lights: typed(".rig-lights", "Lights", true),
      stop_at: number(".rig-stop-at") > 0 ? number(".rig-stop-at") : null,
      seed: typed(".rig-seed", "Seed", true),
      reach: typed(".rig-reach", "Largest slant"),
      nearby: number(".rig-nearby") > 0 ? number(".rig-nearby") : null,
      exposures: camera.exposures(),
      settle: typed(".rig-settle", "Time to settle"),
      brightness: typed(".rig-brightness", "LED"),
      shutter: input(".rig-shutter").checked,
      dark: input(".rig-dark").checked,
      homing: input(".rig-homing").checked,
      sphere: !ball ? null : sim ? { x: 0, y: 0, radius: 1 } : camera.outline,
      misaligned: sim && input(".rig-askew").checked ? ASKEW : [0, 0, 0, 0],
    };
  }

  /** @param {"auto" | "one"} mode @param {boolean} again whether the stored session goes on */
  async function begin(mode, again) {
    say("");
    camera.forget();
    try {
      if (again && stored && !stored.simulated && select(".rig-camera").value === "sim") {
        throw new Error("This session was taken with a camera: choose it first, then continue.");
      }
      if (!again && input(".rig-mirror").checked && select(".rig-camera").value !== "sim" && !camera.outline) {
        throw new Error("Mark the mirror sphere first, or untick it.");
      }
      await client.call("begin", { mode, settings: settings(), camera: camera.chosen(), stored: again });
    } catch (error) {
      failed(error);
      offer(stored);
      $(".rig-discard").hidden = /** @type {Error} */ (error).name !== "Unsaved";
    }
  }

  /** @param {import("./messages.js").Stored | null} session */
  function offer(session) {
    stored = session;
    const again = button(".rig-continue");
    again.hidden = !session && !former;
    const count = session ? ` (${session.taken} of ${session.lights} lights)` : "";
    again.textContent = former ? `Continue session${count} in folder “${former.name}”` : `Continue${count}`;
  }

  /** @param {FileSystemDirectoryHandle | null} folder */
  async function keep(folder) {
    const { session, shown } = await client.call("keep", { folder, settings: settings() });
    former = null;
    offer(session);
    if (!shown) return;
    const { object, taken, lights: all } = shown;
    say(`“${folder?.name}” holds ${session ? "an unfinished" : "a complete"} session of “${object}”, ${taken} of ${all} lights: shown here.`);
  }

  /** Asks for the folder of before the reload. Without it the browser's own copy can go on. @param {FileSystemDirectoryHandle} folder */
  async function openFormer(folder) {
    say("");
    try {
      const answer = await /** @type {any} */ (folder).requestPermission({ mode: "readwrite" });
      if (answer !== "granted") throw new Error("the browser was not allowed to use it");
      await keep(folder);
      return stored !== null;
    } catch (error) {
      former = null;
      offer(stored);
      const rest = stored ? "Continue goes on with the copy in this browser" : "There is no other copy in this browser";
      say(`The folder “${folder.name}” can't be opened: ${explain(error)}. ${rest}; or choose the folder again.`);
      return false;
    }
  }

  on(".rig-folder", async () => {
    try {
      const folder = await chooseFolder("readwrite", "rig-session");
      say(folder ? "" : "This browser can't write to folders, or none was chosen: the session stays in the browser, download it as zip.");
      if (folder) await keep(folder);
    } catch (error) {
      say(explain(error));
    }
  });
  on(".rig-no-folder", () => keep(null).catch(failed));
  on(".rig-zip", async () => {
    try {
      download(new Blob([await client.call("zip", {})], { type: "application/zip" }), "session.zip");
    } catch (error) {
      failed(error);
    }
  });

  on(".rig-auto", () => begin("auto", false));
  on(".rig-next", () => begin("one", false));
  on(".rig-pause", () => {
    $(".rig-ask").hidden = true;
    camera.forget();
    client.call("pause", {}).catch(failed);
  });
  on(".rig-discard", async () => {
    try {
      await client.call("discard", {});
      $(".rig-discard").hidden = true;
      button(".rig-auto").focus();
    } catch (error) {
      failed(error);
    }
  });
  on(".rig-continue", async () => {
    if (former && !await openFormer(former)) return;
    await begin("auto", true);
  });

  return {
    /** @param {import("../messages.js").Catalogue} catalogue */
    list(catalogue) {
      const planners = catalogue.planners.filter(p => !p.oracle);
      const ours = ["coil", "tk22"].find(name => planners.some(p => p.name === name)); // coil, where its module is built
      select(".rig-planner").replaceChildren(...planners.map(p => html("option", { value: p.name, selected: p.name === ours }, p.label)));
      $(".rig-withheld").hidden = !catalogue.withheld;
      $(".rig-withheld").textContent = catalogue.withheld;
      select(".rig-solver").replaceChildren(...catalogue.solvers.filter(s => !IN_PIECES.includes(s.name)).map(s => html("option", { value: s.name, selected: s.name === "trimmed", title: s.about }, s.label)));
    },

    /**
     * What can go on when the page was loaded.
     * @param {import("./messages.js").Stored | null} session @param {FileSystemDirectoryHandle | null} folder where it lay before
     */
    started(session, folder) {
      former = folder;
      offer(session);
    },

    /** @param {import("./messages.js").Ended} told */
    ended({ done, session }) {
      $(".rig-ask").hidden = true;
      offer(session);
      if (done) page.announce("The capture is done");
    },
  };
}
