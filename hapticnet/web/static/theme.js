// Sets the colour theme of the system before the first paint, and follows it.
// A classic script, because modules run after the first paint.

(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const show = () => {
    document.documentElement.dataset.theme = dark.matches ? "dark" : "light";
    dispatchEvent(new Event("themechange"));
  };
  dark.addEventListener("change", show);
  show();
})();
