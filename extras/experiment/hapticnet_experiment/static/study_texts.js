// The study's own words, in its language, from the server.

import { texts } from "./texts.js";

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
