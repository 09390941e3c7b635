// A demonstration of the gallery on the watch view: what to try, its variants, and the way back and on.

import { texts } from "./texts.js";

const asked = new URLSearchParams(location.search);

/** The number of the demonstration that this page shows, from 0; null if it belongs to no gallery. */
const shown = asked.has("show") ? Number(asked.get("show")) - 1 : null;
const variant = Number(asked.get("variant") ?? 0);

export const isInGallery = shown !== null;

/** All demonstrations, with title, sentence, what to try, picture and variants. */
export async function demonstrations() {
  return (await fetch("static/gallery.json")).json();
}

/** The address of the page of a demonstration, or of the index. */
export function addressOf(index = null, place = 0) {
  const query = new URLSearchParams({ token: asked.get("token") ?? "" });
  if (index !== null) query.set("show", index + 1);
  if (place) query.set("variant", place);
  return `?${query}`;
}

/** Fill the part of the page that belongs to the gallery. */
export async function showDemonstration(box) {
  Object.assign(texts, { connecting: "Starting the demonstration", refused: "This demonstration does not run" });
  const all = await demonstrations();
  const one = all[shown];
  if (!one) {
    location.replace(addressOf()); // such as of an older gallery
    return;
  }
  const next = (shown + 1) % all.length;
  document.title = `${one.title} – hapticnet gallery`;
  const [back, on, heading, variants] = box.querySelectorAll("a, h2, ul");
  back.href = addressOf();
  heading.textContent = `${shown + 1} of ${all.length}: ${one.title}`;
  on.href = addressOf(next);
  on.textContent = `Next: ${all[next].title}`;
  variants.replaceChildren(...one.variants.map(({ name }, place) => {
    const item = document.createElement("li");
    const link = document.createElement("a");
    link.className = "tool small";
    link.href = addressOf(shown, place);
    link.textContent = name;
    if (place === variant) link.ariaCurrent = "true";
    item.append(link);
    return item;
  }));
  box.parentElement.querySelector("#try").textContent = `Try it: ${one.try}`;
  for (const part of box.parentElement.querySelectorAll("[data-gallery]")) part.hidden = false;
}
