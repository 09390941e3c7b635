// Bundle the package into dist/: the library as text, and the primitives of sealed sessions.
import { copyFileSync, readFileSync, writeFileSync } from "node:fs";
import { deflateSync } from "node:zlib";
import { build } from "esbuild";

/**
 * Write four bytes as five characters of base 85, '#' to 'x' but no backslash: it is shorter than base64. The first
 * character says how many bytes at the end are padding, of which a browser would complain.
 */
function encode(bytes) {
  const padded = Buffer.concat([bytes, Buffer.alloc(-bytes.length & 3)]);
  let text = String(padded.length - bytes.length);
  for (let at = 0; at < padded.length; at += 4) {
    let five = "";
    for (let left = padded.readUInt32BE(at), i = 0; i < 5; i++, left = Math.floor(left / 85)) {
      const code = 35 + (left % 85);
      five = String.fromCharCode(code < 92 ? code : code + 1) + five;
    }
    text += five;
  }
  return text;
}

// With less memory for it, deflate makes shorter blocks, whose codes fit better: 0.3 % less.
const packed = deflateSync(readFileSync("build/hapticnet.wasm"), { level: 9, memLevel: 6 });
writeFileSync("build/hapticnet.wasm.txt", encode(packed));
await build({
  entryPoints: ["src/index.ts"],
  outfile: "dist/index.js",
  bundle: true,
  minify: true,
  lineLimit: 1000, // Node prints the whole line in which an error was thrown
  format: "esm",
  target: "es2022",
  legalComments: "eof",
  logLevel: "warning",
});

// The link through a gateway, which loads nothing of the library; and the page, which loads both from beside it.
const plain = { bundle: true, minify: true, format: "esm", target: "es2022", legalComments: "eof", logLevel: "warning" };
await build({ ...plain, entryPoints: ["src/gateway.ts"], outfile: "dist/gateway.js" });
const beside = {
  name: "beside",
  setup: ({ onResolve }) =>
    onResolve({ filter: /^\.\.\/src\// }, ({ path }) => ({ path: path.replace("src/", ""), external: true })),
};
await build({ ...plain, entryPoints: ["page/main.ts", "page/ticker.ts"], outdir: "dist/page", plugins: [beside] });
for (const name of ["index.html", "page.css"]) copyFileSync(`page/${name}`, `dist/page/${name}`);
