// Sets the colour theme before the first paint: the reader's choice on this page, else the system's.
// A classic script, because modules run after the first paint.

(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const choice = () => {
    try {
      return localStorage.getItem("hapticnet-theme");
    } catch {
      return null; // storage is switched off
    }
  };
  const show = () => {
    document.documentElement.dataset.theme = choice() ?? (dark.matches ? "dark" : "light");
    dispatchEvent(new Event("themechange"));
  };
  dark.addEventListener("change", show);
  addEventListener("themetoggle", () => {
    const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    try {
      // A choice that agrees with the system is none: the page then follows the system again.
      if ((next === "dark") === dark.matches) localStorage.removeItem("hapticnet-theme");
      else localStorage.setItem("hapticnet-theme", next);
    } catch {
      document.documentElement.dataset.theme = next;
      dispatchEvent(new Event("themechange"));
      return;
    }
    show();
  });
  show();
})();
