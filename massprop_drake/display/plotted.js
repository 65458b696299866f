(function () {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const drawn = [];

  // each plot has its place in the part of the page that it belongs to
  function draw(figure) {
    const host = document.getElementById("plot-" + figure.name);
    const heading = document.createElement("h3"), plot = document.createElement("div"), note = document.createElement("p");
    heading.textContent = figure.title;
    note.textContent = figure.note;
    host.append(heading, plot, note);
    drawn.push({ figure, plot });
    return Plotly.newPlot(plot, themed.traces(figure.traces), themed.layout(figure.layout), themed.options);
  }

  themed.onChange(() => {
    for (const { figure, plot } of drawn) Plotly.react(plot, themed.traces(figure.traces), themed.layout(figure.layout), themed.options);
  });

  (async () => {
    for (const figure of data.plots) { await draw(figure); await new Promise(done => setTimeout(done)); }
    document.body.dataset.ready = "yes";
  })();
})();
