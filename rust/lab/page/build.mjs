// Makes the page without data, `node build.mjs OUT`: one HTML file, one classic script, nothing fetched, so that it opens from
// disk as from any server. `jax_aero.view.web` writes the data into it.
import { build } from "esbuild";
import { readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const { outputFiles } = await build({
  entryPoints: [join(here, "main.js")],
  bundle: true,
  minify: true,
  format: "iife",
  target: ["es2022"],
  write: false,
  legalComments: "eof",
});
const parts = { STYLE: readFileSync(join(here, "style.css"), "utf8"), SCRIPT: outputFiles[0].text.replaceAll("</script", "<\\/script") };
const page = readFileSync(join(here, "index.html"), "utf8");
writeFileSync(process.argv[2], page.replace(/\/\*(STYLE|SCRIPT)\*\//g, (_, name) => parts[name]));
