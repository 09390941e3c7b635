// What both views say to a person. In an experiment the server sends the study's own words, in the study's language.

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

/** Use the words of a study, and put them where the page has fixed ones. */
export function useTexts(own) {
  Object.assign(texts, own);
  document.documentElement.lang = own.language;
  for (const element of document.querySelectorAll("[data-text]")) element.textContent = texts[element.dataset.text];
  for (const element of document.querySelectorAll("[data-label]")) element.ariaLabel = texts[element.dataset.label];
  for (const element of document.querySelectorAll("[data-title]")) element.title = texts[element.dataset.title];
}

/** A text with the words in braces filled in. */
export function filled(text, values) {
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name]);
}
