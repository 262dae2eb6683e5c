// Makes the page: `node build.mjs WASM LOOK OUT COMMIT`. One HTML file, one classic script, nothing fetched, so that it opens from
// disk as from any server.
import { build } from "esbuild";
import { mkdirSync, readFileSync, readdirSync, statSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";

const [wasm, look, out, commit] = process.argv.slice(2);
const here = dirname(fileURLToPath(import.meta.url));
const root = join(here, "../../..");
const MOST = 3e6; // bytes, compressed

// What the choices of `scenario.js` build on.
const KEPT = [
  ["configs/aero", /\.toml$/],
  ["configs/aero/networks", /^default\./],
  ["configs/control", /^(aero_aware|aero_aware_published|baseline|mpc|observer|observer_without_model)\.toml$/],
  ["configs/law", /\.toml$/],
  ["configs/mission", /^(in_line|hover|closed_circuit|min_time)\./],
  ["configs/robot", /^ironcub_mk1\./],
  ["configs/simulator", /^flight(_published)?\.toml$/],
];

const files = {};
const binary = {};
for (const [folder, kept] of KEPT) {
  for (const name of readdirSync(join(root, folder)).sort()) {
    const path = join(root, folder, name);
    if (!statSync(path).isFile() || !kept.test(name)) continue;
    const bytes = readFileSync(path);
    if (name.endsWith(".safetensors")) binary[relative(root, path)] = bytes.toString("base64");
    else files[relative(root, path)] = bytes.toString("utf8");
  }
}

/** A module without its custom sections: names and debugging, a fifth of it. */
function stripped(module) {
  const parts = [module.subarray(0, 8)];
  for (let at = 8; at < module.length; ) {
    const begin = at;
    const id = module[at++];
    let size = 0;
    for (let shift = 0; ; shift += 7) {
      const byte = module[at++];
      size |= (byte & 0x7f) << shift;
      if (byte < 0x80) break;
    }
    at += size;
    if (id !== 0) parts.push(module.subarray(begin, at));
  }
  return Buffer.concat(parts);
}

const data = {
  wasm: stripped(readFileSync(wasm)).toString("base64"),
  look: JSON.parse(readFileSync(look, "utf8")),
  commit: commit || null,
  files,
  binary,
};

async function bundled(entry) {
  const { outputFiles } = await build({
    entryPoints: [join(here, entry)],
    bundle: true,
    minify: true,
    format: "iife",
    target: ["es2022"],
    write: false,
    legalComments: "eof",
    plugins: [
      {
        name: "data",
        setup(made) {
          made.onResolve({ filter: /^lab:data$/ }, () => ({ path: "data", namespace: "lab" }));
          made.onLoad({ filter: /.*/, namespace: "lab" }, () => ({ contents: JSON.stringify(data), loader: "json" }));
        },
      },
    ],
  });
  return outputFiles[0];
}

const script = (await bundled("main.js")).contents;
mkdirSync(out, { recursive: true });
let compressed = gzipSync(script).length;
writeFileSync(join(out, "lab.js"), script);
for (const name of ["index.html", "style.css"]) {
  const text = readFileSync(join(here, name));
  compressed += gzipSync(text).length;
  writeFileSync(join(out, name), text);
}
if (compressed > MOST) throw new Error(`the page has ${compressed} bytes compressed; expected at most ${MOST}`);
console.log(`${out}: ${(compressed / 1e6).toFixed(2)} MB compressed, wasm ${(data.wasm.length * 0.75e-6).toFixed(2)} MB`);

// The page of recorded flights: one file, into which `jax_aero.view.web` writes the flights.
const parts = {
  STYLE: readFileSync(join(here, "style.css"), "utf8"),
  SCRIPT: (await bundled("flight.js")).text.replaceAll("</script", "<\\/script"),
};
const page = readFileSync(join(here, "flight.html"), "utf8").replace(/\/\*(STYLE|SCRIPT)\*\//g, (_, name) => parts[name]);
writeFileSync(join(root, "jax_aero/view/flight.html"), page);
