// Colours of the canvases, read from the style sheet so that both themes are defined in one place.

let cached = null;

/** Return a function from the name of a CSS variable, without its dashes, to its value. */
export function palette() {
  if (!cached) {
    const style = getComputedStyle(document.documentElement);
    const values = new Map();
    cached = (name) => {
      if (!values.has(name)) values.set(name, style.getPropertyValue(`--${name}`).trim());
      return values.get(name);
    };
  }
  return cached;
}

addEventListener("themechange", () => {
  cached = null;
});
