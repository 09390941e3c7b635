// What both views say to a person. A page of another package may put its own words here.

export const texts = {
  connecting: "Connecting",
  reconnecting: "Connecting again",
  closed: "Closed",
  lost: "Connection to the master lost",
  lost_text: "The needle is withdrawn. The page connects again by itself.",
  refused: "The server closed this page",
  retry: "Try again",
  not_possible: "Not possible",
  free: "The needle is free: drag it",
  yours: "You move the needle",
  waiting: "You move the needle; it waits for you",
  withdrawing: "The needle is being withdrawn",
  take: "Move the needle",
  let_go: "Let go",
  withdraw: "Stop the other page",
};
