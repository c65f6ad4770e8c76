// What is to be compared: kept in the address, so that a link shows the same table.

/** @typedef {import("./messages.js").Settings} Settings */
/** @typedef {Extract<import("./messages.js").Source, { kind: "sculpture" }>} Sculpture */

/** @type {Settings} */
export const DEFAULTS = {
  planners: ["random", "dc05v", "tk22", "lipids", "coil", "oracle"],
  solvers: ["ls"],
  lights: [10],
  protocol: "official",
  lookups: ["nearest"],
  draws: 5,
  seed: 1,
};

/** The object that the page begins with. @type {Sculpture} */
export const BUILT_IN = { kind: "sculpture", family: "coral", seed: 5, material: "red-phenolic" };

const NAME = /^[\w:.+-]{1,64}$/;

/**
 * @param {string | null} text
 * @param {string[]} fallback
 */
function names(text, fallback) {
  const list = (text ?? "").split(",").filter(name => NAME.test(name));
  return list.length ? [...new Set(list)] : fallback;
}

/**
 * @param {string | null} text
 * @param {number} low
 * @param {number} high
 * @param {number} fallback
 */
function whole(text, low, high, fallback) {
  const value = Number(text ?? NaN);
  return Number.isInteger(value) && value >= low && value <= high ? value : fallback;
}

/**
 * When runs end early; nothing where `degrees` makes no sense.
 * @param {number} degrees
 * @returns {Pick<Settings, "stop_at">}
 */
export function stopAt(degrees) {
  return degrees > 0 && degrees < 90 ? { stop_at: degrees } : {};
}

/**
 * A look-up, with the width of its blend within what the page's field takes.
 * @param {string | null} text
 */
function lookup(text) {
  const [kind, tau, ...more] = (text ?? "").split(":");
  const soft = kind === "soft" && Number(tau) >= 0.001 && Number(tau) <= 10 && !more.length;
  return soft ? `soft:${Number(tau)}` : DEFAULTS.lookups[0];
}

/**
 * The settings in an address (`location.hash`); what it lacks or garbles is the default.
 * @param {string} hash
 * @returns {{ settings: Settings, sculpture: Sculpture, named: boolean }} named: whether it says which object
 */
export function fromHash(hash) {
  const fields = new URLSearchParams(hash.replace(/^#/, ""));
  const protocol = fields.get("protocol");
  const [family = BUILT_IN.family, seed = null] = (fields.get("object") ?? "").split(":").filter(Boolean);
  return {
    settings: {
      planners: names(fields.get("planners"), DEFAULTS.planners),
      solvers: names(fields.get("solvers"), DEFAULTS.solvers),
      lights: [whole(fields.get("lights"), 3, 1000, DEFAULTS.lights[0])],
      protocol: protocol === "128" || protocol === "official" ? protocol : DEFAULTS.protocol,
      lookups: [lookup(fields.get("lookup"))],
      draws: whole(fields.get("draws"), 1, 1000, DEFAULTS.draws),
      seed: whole(fields.get("seed"), 0, 2 ** 32 - 1, DEFAULTS.seed),
      ...stopAt(Number(fields.get("stop"))),
    },
    named: fields.has("object"),
    sculpture: {
      kind: "sculpture",
      family: NAME.test(family) ? family : BUILT_IN.family,
      seed: whole(seed, 0, 2 ** 32 - 1, BUILT_IN.seed),
      material: names(fields.get("material"), [BUILT_IN.material])[0],
    },
  };
}

/**
 * The address that holds these settings.
 * @param {Settings} settings
 * @param {Sculpture | null} sculpture null for an object of the user's, which no link can hold
 */
export function toHash(settings, sculpture) {
  const fields = new URLSearchParams({
    planners: settings.planners.join(","),
    solvers: settings.solvers.join(","),
    lights: String(settings.lights[0]),
    protocol: settings.protocol,
    lookup: settings.lookups[0],
    draws: String(settings.draws),
    seed: String(settings.seed),
  });
  if (settings.stop_at) fields.set("stop", String(settings.stop_at));
  if (sculpture) {
    fields.set("object", `${sculpture.family}:${sculpture.seed}`);
    fields.set("material", sculpture.material);
  }
  // Commas and colons are legal here and easier to read.
  return `#${fields.toString().replaceAll("%2C", ",").replaceAll("%3A", ":")}`;
}
