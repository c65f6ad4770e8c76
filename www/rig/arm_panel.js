// Moving the arm by hand: its buttons, the jog and the console's line.

/**
 * @param {HTMLElement} root
 * @param {import("./rig.js").Panel} panel
 */
export function mountArm(root, { client, fields, say, failed }) {
  const { $, input, select, typed } = fields;

  /** @param {import("./messages.js").Order} order */
  async function order(order) {
    say("");
    try {
      const { projected } = await client.call("order", { order });
      if (projected > 0) say(`Out of the arm's range: going to the nearest reachable direction, ${projected.toFixed(1)}° off.`);
    } catch (error) {
      failed(error);
    }
  }

  for (const control of root.querySelectorAll("[data-do]")) {
    /** @returns {import("./messages.js").Order} */
    const asked = () => {
      const name = /** @type {HTMLElement} */ (control).dataset.do ?? "";
      if (name === "goto") return { name, azimuth: typed(".rig-az", "Azimuth"), slant: typed(".rig-sl", "Slant") };
      if (name === "lightOn") return { name: "light", brightness: typed(".rig-brightness", "LED") };
      if (name === "lightOff") return { name: "light", brightness: 0 };
      return { name: /** @type {import("./messages.js").Plain} */ (name) };
    };
    control.addEventListener("click", () => {
      try {
        return order(asked());
      } catch (error) {
        failed(error);
      }
    });
  }
  for (const control of root.querySelectorAll("[data-jog]")) {
    control.addEventListener("click", () => {
      const [a, s] = (/** @type {HTMLElement} */ (control).dataset.jog ?? "0,0").split(",").map(Number);
      const step = Number(select(".rig-step").value);
      return order({ name: "jog", azimuth: a * step, slant: s * step });
    });
  }

  $(".rig-type").addEventListener("submit", event => {
    event.preventDefault();
    const line = input(".rig-line").value.trim();
    if (line) void order({ name: "raw", line });
    input(".rig-line").value = "";
  });
}
