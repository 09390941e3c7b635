"""The live page: an HTTP and WebSocket server beside a master, and the files that a browser loads from it."""
