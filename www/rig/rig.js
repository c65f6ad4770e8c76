// The rig view: an arm on a serial port (or the simulated one), its position, and a capture that drives it. All of it
// is computed in the rig's worker (worker.js); here it is shown and asked for. Only here can be: the choice of a port,
// webcams, files, and Stop, which waits for no worker.

import { html } from "../svg.js";
import { mountArm } from "./arm_panel.js";
import { mountCamera } from "./camera_panel.js";
import { mountCapture } from "./capture_panel.js";
import { Client } from "./client.js";
import { mountConnection } from "./connection.js";
import { fields } from "./fields.js";
import { mountStatus } from "./status.js";
import { TEMPLATE } from "./template.js";

/**
 * What a panel is given.
 * @typedef {object} Panel
 * @property {import("../main.js").Page} page
 * @property {Client} client
 * @property {ReturnType<typeof fields>} fields
 * @property {(text: string) => void} say in the bar, aloud; empty: what was said is settled
 * @property {(error: unknown) => void} failed says why
 */

/** How many times as fast as a real one the simulated arm is: `?pace=4` in the page's address. */
function pace() {
  const given = Number(new URLSearchParams(location.search).get("pace"));
  return given >= 1 && given <= 20 ? given : 1;
}

/**
 * @param {HTMLElement} root
 * @param {import("../main.js").Page} page
 */
export async function mount(root, page) {
  if (!document.querySelector("link[href$='rig/rig.css']")) {
    document.head.append(html("link", { rel: "stylesheet", href: new URL("rig.css", import.meta.url).href }));
  }
  root.classList.add("rig");
  root.innerHTML = TEMPLATE;

  const client = new Client(heard, error => page.problem("The rig's worker has failed", error, "Reload the page; the session is stored."));
  const at = fields(root);
  const say = (/** @type {string} */ text) => { at.$(".rig-said").textContent = text; };
  const failed = (/** @type {unknown} */ error) => say(/** @type {Error} */ (error).message);
  const panel = { page, client, fields: at, say, failed };
  const status = mountStatus(root, panel);
  const camera = mountCamera(root, panel);
  const connection = mountConnection(root, panel, status, camera);
  const capture = mountCapture(panel, camera);
  mountArm(root, panel);
  addEventListener("pagehide", () => { connection.close(); camera.close(); });

  /** @param {import("./messages.js").Told} told */
  function heard(told) {
    switch (told.type) {
      case "state": return status.showState(told);
      case "taken": return status.showTaken(told);
      case "expose": return void camera.expose(told);
      case "help": return connection.help(told.text);
      case "problem": return page.problem("The capture can't go on", new Error(told.message), "What was captured is stored; continue when the cause is mended.");
      case "ended": return capture.ended(told);
    }
  }

  const { limits, fitted, session, folder } = await client.call("start", { arm: status.keptFit(), pace: pace() });
  status.started(limits, fitted);
  capture.list(await page.engine.call("catalogue", {}));
  await connection.listPorts();
  capture.started(session, folder);
}
