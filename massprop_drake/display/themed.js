// what pages with plots share: figures in the colors of the theme
const themed = (() => {
  "use strict";
  const BAR = 36, ROWS = 34; // room for plotly's bar of buttons, pixels, and for more rows of a key in a narrow card
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

  // of a figure; `wraps`: whether its key may need more rows than it was given
  function layout(of, wraps = false) {
    const ink = style("--ink"), grid = style("--line"), copy = inked(of, ink);
    for (const key of Object.keys(copy)) if (/^[xy]axis/.test(key)) Object.assign(copy[key], { gridcolor: grid, zerolinecolor: grid });
    // where nothing hovers the bar of buttons is always there: it gets a place of its own, above all else
    if (matchMedia("(hover: none)").matches && copy.margin && copy.height) {
      const room = BAR + (wraps ? ROWS : 0);
      copy.margin.t += room;
      copy.height += room;
    }
    return Object.assign(copy, { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, size: 11 },
                                 modebar: { bgcolor: "rgba(0,0,0,0)", color: style("--soft"), activecolor: ink },
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

  // names each cell of a table by the heads of its column: on a narrow screen a row is a card
  for (const table of document.querySelectorAll(".wide table")) {
    const heads = [], rows = [...table.rows];
    while (rows.length && ![...rows[0].cells].some(cell => cell.tagName === "TD" && cell.textContent || cell.scope === "row")) heads.push(rows.shift());
    if (!heads.length) continue;
    const names = [], below = []; // by column, and how many more rows of heads a head spans
    for (const head of heads) {
      let column = 0;
      for (const cell of head.cells) {
        while (below[column] > 0) below[column++] -= 1;
        for (let part = 0; part < cell.colSpan; part++, column++) {
          names[column] = [names[column], cell.textContent.trim()].filter(Boolean).join(" ");
          below[column] = cell.rowSpan - 1;
        }
      }
      head.classList.add("heads");
    }
    table.classList.add("cards");
    for (const row of rows) for (const [column, cell] of [...row.cells].entries()) if (names[column]) cell.dataset.of = names[column];
  }

  const options = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };

  return { traces, layout, onChange, options };
})();
