// A peer for peers/conformance: it reads lines from stdin and writes answers to stdout.
import { createInterface } from "node:readline";
import { conversation } from "./lines.mjs";

const answer = conversation();
for await (const line of createInterface({ input: process.stdin })) process.stdout.write(`${answer(line)}\n`);
