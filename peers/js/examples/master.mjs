// A master: it moves in and out of the slave's scene for some seconds, and prints what it would feel.
// First: hapticnet slave --scene paper. Then: node master.mjs [ADDRESS [PORT [SECONDS]]]
import { createSocket } from "node:dgram";
import { Master, now, overSocket, run } from "hapticnet";

process.on("uncaughtException", ({ message }) => {
  console.error(message); // a line for people, without a stack
  process.exit(2);
});
const [address = "127.0.0.1", port = "47800", seconds = "5"] = process.argv.slice(2);
const socket = createSocket("udp4");
const startUs = now();
const master = new Master({ codec: "deadband", name: "Node" });
let positionM = 0;
let forceN = 0;
const show = () => console.log(`${(1000 * positionM).toFixed(2)} mm  ${forceN.toFixed(2)} N  ${master.state}`);
const shown = setInterval(show, 100);
const ended = await run(master, {
  transport: overSocket(socket, Number(port), address),
  hand: (nowUs) => [(positionM = 0.015 * (1 - Math.cos((2 * Math.PI * (nowUs - startUs)) / 1e6 / seconds)))],
  feel: ([force]) => (forceN = force),
  signal: AbortSignal.timeout(1000 * seconds),
});
clearInterval(shown);
socket.close();
if (ended) console.log(ended.text);
