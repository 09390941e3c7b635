// The operator view: scene and hand only. The server sends it nothing that would reveal the condition of a trial.

import { Stage } from "./stage.js";

const stage = new Stage("operator", {
  ready: ({ ready }) => stage.setLink(ready ? "good" : "warn", ready ? "Ready" : "Not ready"),
});
