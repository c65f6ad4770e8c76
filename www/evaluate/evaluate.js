// The view that compares planners on one object: its state, what can be done, and its panels.

import { DEFAULTS, fromHash, toHash } from "../settings.js";
import { isAbort } from "../engine.js";
import { LEARNED } from "../learned.js";
import { IN_PIECES } from "../solvers.js";
import { newestOnly, Store } from "../store.js";
import { find } from "../svg.js";
import { mountChart } from "./chart.js";
import { mountDome } from "./dome_panel.js";
import { mountMaps } from "./maps.js";
import { mountObject } from "./object.js";
import { mountResults } from "./results.js";
import { label, solverLabel } from "./series.js";
import { mountSettings } from "./settings_panel.js";

/** @typedef {import("../main.js").Page} Page */
/** @typedef {import("../messages.js").Catalogue} Catalogue */
/** @typedef {import("../messages.js").Direction} Direction */
/** @typedef {import("../messages.js").Insight} Insight */
/** @typedef {import("../messages.js").ObjectInfo} ObjectInfo */
/** @typedef {import("../messages.js").Picture} Picture */
/** @typedef {import("../messages.js").Report} Report */
/** @typedef {import("../messages.js").ResultRow} ResultRow */
/** @typedef {import("../messages.js").RunStep} RunStep */
/** @typedef {import("../messages.js").Settings} Settings */
/** @typedef {import("../messages.js").Source} Source */
/** @typedef {import("../messages.js").StackInfo} StackInfo */
/** @typedef {import("../messages.js").StepView} StepView */

/**
 * Which step of which run is looked at.
 * @typedef {{ planner: string, solver: string, step: number }} Shown
 *
 * @typedef {object} State
 * @property {Catalogue | null} catalogue
 * @property {Settings} settings
 * @property {Source} source
 * @property {ObjectInfo | null} object
 * @property {StackInfo | null} stack
 * @property {{ done: number, total: number, what: string } | null} opening
 * @property {{ done: number, total: number, what?: string } | null} running
 * @property {Map<string, RunStep[]>} runs first run of every planner, step by step
 * @property {ResultRow[]} rows the table so far
 * @property {Report | null} report the table when it is complete
 * @property {Settings | null} ran what the table was made with
 * @property {Shown} shown
 * @property {StepView & { of: Shown } | null} view the newest maps there are, and of which step
 * @property {Insight | null} insight the learned planner that is shown, at work
 * @property {number} scale of the error map, degrees
 * @property {Direction} sun
 * @property {Picture | null} relit
 *
 * @typedef {object} Panel what a panel is given
 * @property {Page} page
 * @property {Store<State>} store
 * @property {ReturnType<typeof makeActions>} actions
 */

/** The planner that is shown after the first run. */
const OURS = "coil";
/** A step that is no longer wanted need not end at once: a new worker would have to open the object again. */
const VIEW_PATIENCE_MS = 2000;

/** @type {Direction} */
const FIRST_SUN = [-0.38, 0.46, 0.803];

/**
 * @param {HTMLElement} root
 * @param {Page} page
 */
export async function mount(root, page) {
  const { settings, sculpture } = fromHash(location.hash);
  const store = new Store(/** @type {State} */ ({
    catalogue: null, settings, source: sculpture, object: null, stack: null, opening: null, running: null,
    runs: new Map(), rows: [], report: null, ran: null,
    shown: { planner: "", solver: settings.solvers[0], step: 0 },
    view: null, insight: null, scale: 30, sun: FIRST_SUN, relit: null,
  }));
  const actions = makeActions(page, store);
  const panel = { page, store, actions };
  mountObject(find(root, "#object", HTMLElement), panel);
  mountSettings(find(root, "#settings", HTMLFormElement), panel);
  mountDome(find(root, "#dome", HTMLElement), panel);
  mountMaps(find(root, "#maps", HTMLElement), panel);
  mountChart(find(root, "#chart", HTMLElement), panel);
  mountResults(find(root, "#results", HTMLElement), panel);

  const catalogue = await page.engine.call("catalogue", {});
  store.update({ catalogue, settings: known(settings, catalogue) });
  window.addEventListener("hashchange", () => actions.follow(location.hash));
  await actions.open(store.state.source);
}

/**
 * The settings without planners and solvers that this build does not have.
 * @param {Settings} settings
 * @param {Catalogue} catalogue
 * @returns {Settings}
 */
function known(settings, catalogue) {
  const planners = settings.planners.filter(name => name === "all" || name.startsWith("ring:") || catalogue.planners.some(p => p.name === name));
  const solvers = settings.solvers.filter(name => catalogue.solvers.some(s => s.name === name));
  return {
    ...settings,
    planners: planners.length ? planners : DEFAULTS.planners.filter(name => catalogue.planners.some(p => p.name === name)),
    solvers: solvers.length ? solvers : DEFAULTS.solvers,
  };
}

/**
 * @param {Page} page
 * @param {Store<State>} store
 */
function makeActions(page, store) {
  const { engine } = page;
  let opening = new AbortController();
  let running = new AbortController();
  let viewing = new AbortController();
  /** Whether someone has chosen what to look at since the run began. */
  let chosen = false;
  /** Whether a run made way for an object that is being opened. */
  let displaced = false;

  const refresh = newestOnly(async () => {
    const { shown: of, scale, runs, ran } = store.state;
    const { planner, solver, step } = of;
    const asked = (runs.get(planner) ?? []).slice(0, step).map(taken => taken.step.requested);
    if (!asked.length || !ran) return;
    const { signal } = viewing = new AbortController();
    const onProgress = (/** @type {StepView} */ view) => {
      if (signal.aborted) return;
      store.update({ view: { ...view, of } });
      relight();
    };
    try {
      onProgress(await engine.call("view", { asked, lookup: ran.lookups[0], solver, scale }, { signal, onProgress, patience: VIEW_PATIENCE_MS }));
      if (planner in LEARNED) look();
      else store.update({ insight: null });
    } catch (error) {
      page.problem(RUNNING[1], error);
    }
  });

  const look = newestOnly(async () => {
    if (store.state.running) return store.update({ insight: null }); // the run needs the worker
    try {
      store.update({ insight: await engine.call("insight", { planner: store.state.shown.planner, lights: store.state.ran?.lights[0] ?? 0 }) });
    } catch (error) {
      page.problem("The planner can't be watched", error);
    }
  });

  const relight = newestOnly(async () => {
    if (!store.state.view?.normals) return store.update({ relit: null });
    try {
      const relit = await engine.call("relight", { light: store.state.sun });
      if (relit) store.update({ relit }); // else a newer view is on its way
    } catch (error) {
      page.problem("The object can't be relit", error);
    }
  });

  /**
   * Completes the curves of the solvers that are too slow to be asked after every light, while nothing else is to be done.
   * @param {Settings} settings
   * @param {AbortSignal} signal ends it
   */
  async function complete(settings, signal) {
    const solvers = settings.solvers.filter(name => IN_PIECES.includes(name));
    if (!solvers.length) return;
    const first = store.state.shown.planner;
    const names = [first, ...settings.planners.filter(name => name !== first)];
    try {
      for (const name of names) {
        const run = store.state.runs.get(name) ?? [];
        for (let steps = run.length; steps >= 3; steps -= 1) {
          if (solvers.every(solver => typeof run[steps - 1].errors[solver] === "number")) continue;
          const asked = run.slice(0, steps).map(taken => taken.step.requested);
          const errors = await engine.call("score", { asked, lookup: settings.lookups[0], solvers }, { signal, patience: VIEW_PATIENCE_MS });
          if (signal.aborted) return;
          const runs = solvers.reduce((runs, solver, i) => withError(runs, { name, steps, solver, error: errors[i] }), store.state.runs);
          store.update({ runs });
        }
      }
    } catch (error) {
      page.problem("The learned solvers' curves can't be completed", error);
    }
  }

  /** @param {Partial<Shown>} patch */
  function lookAt(patch) {
    const shown = { ...store.state.shown, ...patch };
    const steps = store.state.runs.get(shown.planner)?.length ?? 0;
    if (patch.planner && patch.step === undefined) shown.step = steps;
    shown.step = Math.min(Math.max(shown.step, 1), Math.max(steps, 1));
    store.update({ shown });
    viewing.abort(); // what is still being solved is of no interest any more
    refresh();
  }

  engine.onRestored = () => { if (store.state.view) refresh(); };
  engine.onLost = error => {
    page.problem(OPENING[0], error, "The files could not be read again: open the object once more.");
    store.update(NOTHING);
  };

  const actions = {
    /**
     * Opens an object and runs the settings on it.
     * @param {Source} source
     */
    async open(source) {
      displaced ||= store.state.running !== null;
      opening.abort();
      running.abort();
      const { signal } = opening = new AbortController();
      page.mended(...OPENING);
      store.update({ opening: { done: 0, total: 1, what: "opening" } });
      try {
        const object = await engine.call("open", { source }, {
          signal,
          onProgress: progress => { if (!signal.aborted) store.update({ opening: progress }); },
        });
        store.update({ source, object, stack: null });
        page.announce(`${object.name} is open.`);
        for (const note of object.notes) page.announce(note);
        actions.link();
        store.update({ opening: null });
        await actions.run();
      } catch (error) {
        page.problem(OPENING[0], error, ADVICE[source.kind]);
        if (opening.signal !== signal) return;
        store.update({ opening: null });
        if (!engine.opened) store.update(NOTHING);
        else if (displaced) await actions.run();
      }
    },

    cancelOpening() {
      opening.abort();
      page.announce("Opening was cancelled.");
    },

    /** @param {Settings} settings */
    change(settings) {
      store.update({ settings });
      actions.link();
    },

    /** Puts the settings into the address. */
    link() {
      const { settings, source } = store.state;
      history.replaceState(null, "", toHash(settings, source.kind === "sculpture" ? source : null));
    },

    /** @param {string} hash an address that someone has typed or pasted */
    async follow(hash) {
      const { settings, sculpture, named } = fromHash(hash);
      const { catalogue, source } = store.state;
      store.update({ settings: catalogue ? known(settings, catalogue) : settings });
      if ((named || source.kind === "sculpture") && JSON.stringify(source) !== JSON.stringify(sculpture)) await actions.open(sculpture);
      else if (store.state.object) await actions.run();
    },

    /** Runs the settings on the object; ends a run that is under way. */
    async run() {
      running.abort();
      viewing.abort();
      const { signal } = running = new AbortController();
      const { settings, shown } = store.state;
      page.mended(...RUNNING);
      chosen = displaced = false;
      const planner = settings.planners.includes(shown.planner) ? shown.planner : settings.planners[settings.planners.length > 1 ? 1 : 0];
      const solver = settings.solvers.includes(shown.solver) ? shown.solver : settings.solvers[0];
      store.update({
        running: { done: 0, total: 1 }, runs: new Map(), rows: [], report: null, ran: settings, view: null, insight: null, relit: null,
        shown: { planner, solver, step: 0 },
      });
      page.announce("Running.");
      try {
        const stack = await engine.call("prepare", { protocol: settings.protocol }, { signal });
        store.update({ stack });
        // The run that is shown comes first: its normals are what everyone waits for.
        const planners = [planner, ...settings.planners.filter(name => name !== planner)];
        const made = await engine.call("run", { settings: { ...settings, planners } }, {
          signal,
          onProgress: ({ done, total, what, step, late, row }) => {
            if (signal.aborted) return;
            const { runs, rows, shown: now } = store.state;
            store.update({ running: { done, total, what }, ...(row.length ? { rows: [...rows, ...row] } : {}) });
            if (late) store.update({ runs: withError(runs, late) });
            if (!step) return;
            const steps = [...(runs.get(step.name) ?? []), step];
            store.update({ runs: new Map(runs).set(step.name, steps) });
            // The view follows the run that is shown, until someone looks at an earlier step. As long as that run has not
            // begun, and nobody has chosen it, another one is better than nothing.
            const follows = chosen
              ? step.name === now.planner && now.step >= steps.length - 1
              : step.name === planner || !runs.has(planner) && (step.name === now.planner || !runs.has(now.planner));
            if (follows) lookAt({ planner: step.name, step: steps.length });
          },
        });
        const place = (/** @type {ResultRow} */ row) => settings.planners.indexOf(row.planner);
        const report = { ...made, settings, results: made.results.toSorted((a, b) => place(a) - place(b)) };
        store.update({ report, rows: report.results });
        page.announce(summary(report, store.state.catalogue));
        complete(settings, signal);
      } catch (error) {
        if (isAbort(error) && running.signal === signal) page.announce("The run was cancelled.");
        page.problem(RUNNING[0], error);
        if (!engine.opened) store.update(NOTHING);
      } finally {
        if (running.signal === signal) {
          store.update({ running: null });
          // The first thing to see is there at once, of a planner that needs no network; then ours, if nobody looks at something else.
          if (!chosen && shown.planner === "" && store.state.shown.planner === planner && store.state.runs.has(OURS)) lookAt({ planner: OURS });
          // For learned planners the worker changes to the build that has them, and what was shown goes with the other one.
          else if (store.state.view && settings.planners.some(name => name in LEARNED)) refresh();
        }
      }
    },

    cancel() {
      running.abort();
      store.update({ running: null });
    },

    /** Shows what someone has chosen. @param {Partial<Shown>} patch */
    show(patch) {
      chosen = true;
      lookAt(patch);
    },

    /** @param {number} scale degrees */
    rescale(scale) {
      store.update({ scale });
      viewing.abort();
      refresh();
    },

    /** @param {Direction} sun */
    relight(sun) {
      store.update({ sun });
      relight();
    },
  };
  return actions;
}

/**
 * Puts the error of a step in that was solved after the run.
 * @param {State["runs"]} runs
 * @param {import("../messages.js").LateError} late
 */
function withError(runs, { name, steps, solver, error }) {
  const run = (runs.get(name) ?? []).map((step, i) => i + 1 === steps ? { ...step, errors: { ...step.errors, [solver]: error } } : step);
  return new Map(runs).set(name, run);
}

/** Titles of what goes wrong with an object, and with a run and what is shown of it. */
const OPENING = ["This object can't be opened"];
const RUNNING = ["The run has failed", "This step can't be shown"];

/** State without an object. */
const NOTHING = /** @type {Partial<State>} */ ({ object: null, stack: null, view: null, insight: null, relit: null });

/** What can be done when an object can't be opened. */
const ADVICE = {
  files: "Expected is a DiLiGenT object: a folder (or a .zip of it) with filenames.txt, light_directions.txt, "
    + "light_intensities.txt, mask.png, the images, and Normal_gt.mat or normal.txt where the true normals are known.",
  mesh: "Expected is a triangle mesh as OBJ, PLY or STL.",
  sculpture: "Choose another shape or material, or open the built-in object.",
};

/** @param {Report} report @param {Catalogue | null} catalogue */
function summary(report, catalogue) {
  const best = report.results.filter(row => row.mae !== null && !row.oracle).sort((a, b) => (a.mae ?? 0) - (b.mae ?? 0))[0];
  return best ? `Done. Best: ${label(catalogue, best.planner)} with ${solverLabel(catalogue, best.solver)}, ${best.mae?.toFixed(2)} degrees.` : "Done.";
}
