// Checks the types of the page against those of the module that was built, wherever cargo's target folder is.

import { spawnSync } from "node:child_process";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { TARGET, WWW } from "./support.js";

const project = join(TARGET, "page/tsconfig.json");
writeFileSync(project, JSON.stringify({
  extends: join(WWW, "tsconfig.json"),
  compilerOptions: { rootDirs: [WWW, join(TARGET, "page")], typeRoots: [join(WWW, "node_modules/@types")] },
  include: [join(WWW, "**/*.js")],
  exclude: [join(WWW, "node_modules")],
}));
const { status } = spawnSync(join(WWW, "node_modules/.bin/tsc"), ["--project", project], { stdio: "inherit" });
process.exit(status ?? 1);
