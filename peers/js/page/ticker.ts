// A worker that waits: browsers hold the timers of a hidden page back to one a second, but not those of its workers.

const { port1, port2 } = new MessageChannel();

// A message between two timers ends the chain after which browsers make each wait for 4 ms.
onmessage = ({ data: ms }: MessageEvent<number>) => void setTimeout(() => port2.postMessage(0), ms);
port1.onmessage = () => postMessage(0);
