// Bundle the package into dist/: the library as base64, the primitives of sealed sessions, one file of declarations.
import { readFileSync, writeFileSync } from "node:fs";
import { deflateSync } from "node:zlib";
import { build } from "esbuild";

writeFileSync("build/hapticnet.wasm.z", deflateSync(readFileSync("build/hapticnet.wasm"), { level: 9 }));
await build({
  entryPoints: ["src/index.ts"],
  outfile: "dist/index.js",
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  loader: { ".z": "base64" },
  legalComments: "eof",
  logLevel: "warning",
});
