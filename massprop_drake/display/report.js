(function () {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const host = document.getElementById("plots"), slider = document.getElementById("cursor-slider");
  const first = data.time[0], last = data.time[data.time.length - 1];
  const drawn = [];
  let logarithmic = true, linking = false;

  // a figure in the colors of the theme, showing one of its views
  function shown(figure) {
    const layout = themed.layout(figure.layout);
    const traces = figure.traces.map(({ view, ...trace }) => {
      const visible = view === undefined || (view === "log") === logarithmic;
      return { x: data.time, ...themed.traces(trace), visible };
    });
    for (const key of figure.views) layout[key].type = logarithmic ? "log" : "linear";
    return { traces, layout };
  }

  function place(entry, time) {
    const axis = entry.plot._fullLayout.xaxis, area = entry.plot._fullLayout._size;
    const x = axis._offset + axis.l2p(time);
    const inside = x >= axis._offset - 1 && x <= axis._offset + axis._length + 1;
    Object.assign(entry.line.style, { display: inside ? "block" : "none", left: entry.plot.offsetLeft + x + "px",
                                      top: entry.plot.offsetTop + area.t + "px", height: area.h + "px" });
    entry.line.dataset.time = time;
  }

  function cursor(time) {
    const now = Math.max(first, Math.min(last, time));
    slider.value = now;
    document.getElementById("cursor-time").textContent = now.toFixed(2) + " s";
    for (const entry of drawn) place(entry, now);
  }

  function link(from, change) {
    if (linking) return;
    let range = null;
    if (change["xaxis.range[0]"] !== undefined) range = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    else if (change["xaxis.autorange"]) range = [first, last];
    if (!range) return;
    linking = true;
    Promise.all(drawn.map(entry => Plotly.relayout(entry.plot, { "xaxis.range": range, "xaxis.autorange": false })))
      .then(() => { linking = false; cursor(Number(slider.value)); });
  }

  function draw(figure) {
    const card = document.createElement("section"), heading = document.createElement("h3"), plot = document.createElement("div"), line = document.createElement("div");
    card.className = "plot" + (figure.layout.height > 560 ? " tall" : "");
    card.id = "plot-" + figure.name;
    heading.textContent = figure.title;
    line.className = "cursor";
    card.append(heading, plot, line);
    if (figure.note) { const note = document.createElement("p"); note.textContent = figure.note; card.append(note); }
    host.append(card);
    const entry = { figure, plot, line }, drawing = shown(figure);
    return Plotly.newPlot(plot, drawing.traces, drawing.layout, themed.options).then(() => {
      drawn.push(entry);
      plot.on("plotly_hover", event => cursor(event.points[0].x));
      plot.on("plotly_relayout", change => link(entry, change));
      plot.on("plotly_afterplot", () => place(entry, Number(slider.value)));
      place(entry, Number(slider.value));
    });
  }

  function redraw() {
    for (const entry of drawn) {
      const drawing = shown(entry.figure);
      drawing.layout.xaxis.range = entry.plot._fullLayout.xaxis.range.slice();  // a zoom stays
      Plotly.react(entry.plot, drawing.traces, drawing.layout, themed.options);
    }
  }

  slider.min = first; slider.max = last; slider.value = first;
  slider.addEventListener("input", () => cursor(Number(slider.value)));
  document.getElementById("zoom-out").addEventListener("click", () => link(null, { "xaxis.autorange": true }));
  document.getElementById("views").addEventListener("click", event => {
    logarithmic = !logarithmic;
    event.target.textContent = "Errors: " + (logarithmic ? "logarithmic" : "linear");
    event.target.setAttribute("aria-pressed", String(logarithmic));
    redraw();
  });
  themed.onChange(redraw);
  addEventListener("resize", () => requestAnimationFrame(() => cursor(Number(slider.value))));

  (async () => {
    for (const figure of data.plots) { await draw(figure); await new Promise(done => setTimeout(done)); }
    cursor(first);
    document.body.dataset.ready = "yes";
  })();
})();
