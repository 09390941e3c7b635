// The index of the gallery: a card for each demonstration.

import { addressOf, demonstrations } from "./demonstration.js";

const list = document.getElementById("shows");

try {
  list.replaceChildren(...(await demonstrations()).map(card));
} catch {
  const line = document.createElement("li");
  line.textContent = "The gallery has ended. Start it again, and open the address that it prints.";
  list.replaceChildren(line);
}

function card({ title, sentence, picture }, index) {
  const item = document.createElement("li");
  const link = document.createElement("a");
  link.className = "card";
  link.href = addressOf(index);
  const image = new Image(320, 180);
  image.src = `static/${picture}`;
  image.alt = "";
  const heading = document.createElement("h2");
  heading.id = `show-${index}`;
  heading.textContent = title;
  const words = document.createElement("p");
  words.id = `words-${index}`;
  words.textContent = sentence;
  link.setAttribute("aria-labelledby", heading.id); // a screen reader says the title first, then the sentence
  link.setAttribute("aria-describedby", words.id);
  link.append(image, heading, words);
  item.append(link);
  return item;
}
