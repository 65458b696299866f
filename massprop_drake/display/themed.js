// what pages with plots share: figures in the colors of the theme
const themed = (() => {
  "use strict";
  const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  // a copy in which black, as a color, is the ink of the theme
  function inked(part, ink) {
    if (Array.isArray(part)) return part.some(item => item !== null && typeof item === "object") ? part.map(item => inked(item, ink)) : part;
    if (part === null || typeof part !== "object") return part;
    const copy = {};
    for (const [key, value] of Object.entries(part)) {
      copy[key] = key === "color" && value === "#000000" ? ink : inked(value, ink);
    }
    return copy;
  }

  function traces(of) { return inked(of, style("--ink")); }

  function layout(of) {
    const ink = style("--ink"), grid = style("--line"), copy = inked(of, ink);
    for (const key of Object.keys(copy)) if (/^[xy]axis/.test(key)) Object.assign(copy[key], { gridcolor: grid, zerolinecolor: grid });
    return Object.assign(copy, { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, size: 11 },
                                 hoverlabel: { namelength: -1 }, hovermode: "closest", dragmode: "zoom" });
  }

  // the button with the id "theme", and the reader's system, change the colors
  function onChange(redraw) {
    const dark = matchMedia("(prefers-color-scheme: dark)");
    document.getElementById("theme").addEventListener("click", () => {
      const root = document.documentElement, isDark = root.dataset.theme ? root.dataset.theme === "dark" : dark.matches;
      root.dataset.theme = isDark ? "light" : "dark";
      redraw();
    });
    dark.addEventListener("change", redraw);
  }

  const options = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };

  return { traces, layout, onChange, options };
})();
