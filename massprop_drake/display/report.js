(function () {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  // every list of numbers is there once, and every shape
  const does = { minus: value => -value, abs: Math.abs };
  const listed = at => typeof at === "number" ? data.lists[at] : data.lists[at[0]].map(value => value === null ? null : does[at[1]](value));
  for (const figure of data.plots) for (const trace of figure.traces) for (const key of ["x", "y"]) if (key in trace) trace[key] = listed(trace[key]);
  for (const { layout } of data.plots) layout.shapes = layout.shapes.map(shape => data.shapes[shape]);

  const host = document.getElementById("plots"), slider = document.getElementById("cursor-slider");
  const first = data.time[0], last = data.time[data.time.length - 1];
  const drawn = [];
  let logarithmic = true, linking = false, range = [first, last];

  const make = (tag, text, className) => {
    const made = document.createElement(tag);
    if (text) made.textContent = text;
    if (className) made.className = className;
    return made;
  };
  const NARROW = 430; // card, pixels; every one on paper is
  const ROW = 400; // height of a row of plots that a tall one counts for, pixels
  const PAPER = 330; // width of a column of plots on paper, pixels
  const onPaper = () => document.documentElement.dataset.print === "yes";
  const whole = () => range[0] <= first && range[1] >= last;
  const seen = trace => trace.view === undefined || (trace.view === "log") === logarithmic;
  const times = trace => trace.x || data.time;
  // a path over a quantity in place of the time, and whether a figure has such
  const over = trace => trace.meta && trace.meta.over;
  const plane = figure => figure.traces.some(over);

  // ---- views: vertical axes follow the zoom in time

  // the last place in ascending times at or before one; -1 for none
  function placeOf(all, time) {
    let low = 0, high = all.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (all[middle] <= time + 1e-9) low = middle + 1; else high = middle;
    }
    return low - 1;
  }

  // least and greatest value of the traces of an axis within the times that are shown; null for none
  function extent(figure, axis) {
    const log = figure.layout[axis].type === "log" || axis in figure.views && logarithmic;
    let low = Infinity, high = -Infinity;
    for (const trace of figure.traces) {
      if (trace.visible === false || !seen(trace) || "yaxis" + trace.yaxis.slice(1) !== axis) continue;
      const x = times(trace), held = trace.mode === "lines" && trace.connectgaps !== false;
      let begin = held ? Math.max(0, placeOf(x, range[0])) : 0;
      for (; begin < x.length; begin++) {
        if (x[begin] === null || !held && x[begin] < range[0]) continue;
        if (x[begin] > range[1]) { if (held) break; continue; }
        const value = trace.y[begin];
        if (value === null || log && value <= 0) continue;
        low = Math.min(low, value); high = Math.max(high, value);
      }
    }
    if (low > high) return null;
    if (log && figure.layout[axis].range) low = Math.min(high, Math.max(low, 10 ** figure.layout[axis].range[0]));
    if (log && axis in figure.views) low = Math.min(high, Math.max(low, figure.views[axis]));
    if (log) return [Math.log10(low) - 0.1, Math.log10(high) + 0.1];
    const margin = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
    return [low - margin, high + margin];
  }

  // ---- axes that show most of their points: as the page was made with them, of those in the window

  const median = values => values.length ? values.map(Math.abs).sort((one, other) => one - other)[(values.length - 1) >> 1] : 0;
  const of = (figure, axis) => figure.traces.filter(trace => !trace.edge && "yaxis" + trace.yaxis.slice(1) === axis);
  const within = trace => trace.y.filter((value, place) => value !== null && trace.x[place] >= range[0] && trace.x[place] <= range[1]);
  const reach = (figure, axis) => 1.5 * Math.max(...of(figure, axis).map(trace => (trace.mode === "lines" ? 1 : 4.45) * median(within(trace))));

  // the points beyond the axis, as triangles at its edge
  function edge(figure, { edge: side, yaxis, ...trace }) {
    const limit = reach(figure, "yaxis" + yaxis.slice(1)), sign = side === "up" ? 1 : -1, x = [], text = [];
    let count = 0;
    for (const points of of(figure, "yaxis" + yaxis.slice(1))) if (points.mode === "markers") points.y.forEach((value, place) => {
      const time = points.x[place];
      if (Math.abs(value) <= limit || time < range[0] || time > range[1]) return;
      count += 1;
      if (sign * value > 0) { x.push(time); text.push(time + " s: " + number(value)); }
    });
    return { ...trace, yaxis, x, y: x.map(() => 0.94 * sign * limit), text, name: count + " beyond the axis", showlegend: sign > 0 && count > 0 };
  }

  // ranges of a path for the times that are shown
  function around(figure) {
    const changes = {};
    for (const path of figure.traces.filter(over)) for (const letter of ["x", "y"]) {
      const key = letter + "axis" + path[letter + "axis"].slice(1);
      const values = whole() ? [] : part(path[letter]).filter(value => value !== null);
      const low = Math.min(...values), high = Math.max(...values), margin = 0.1 * (high - low) || 1e-3;
      changes[key + ".range"] = values.length ? [low - margin, high + margin] : figure.layout[key].range.slice();
    }
    return changes;
  }

  // ranges for the times that are shown, as `Plotly.relayout` takes them; axes of time apart
  function vertical(figure) {
    if (plane(figure)) return around(figure);
    const changes = {};
    for (const key of Object.keys(figure.layout)) {
      if (!/^yaxis/.test(key) || figure.layout[key].tickvals) continue;
      const bounded = key in figure.views && logarithmic;
      const most = figure.most.includes(key) && reach(figure, key);
      const found = most ? [-most, most] : whole() && !bounded ? figure.layout[key].range || null : extent(figure, key);
      if (found) changes[key + ".range"] = found.slice();
      else changes[key + ".autorange"] = true;
    }
    return changes;
  }

  // of values at the sample times, those at the times that are shown; others are null
  const part = values => values.map((value, row) => data.time[row] < range[0] - 1e-9 || data.time[row] > range[1] + 1e-9 ? null : value);

  // panels over quantities stand beside each other where there is room, else one above the other
  function arrange(layout, width) {
    const keys = Object.keys(layout).filter(key => /^yaxis/.test(key));
    if (width < 230 * keys.length) return;
    keys.forEach((key, number) => {
      const left = number / keys.length;
      layout[key.replace("y", "x")].domain = [left + (number ? 0.07 : 0), left + 1 / keys.length];
      layout[key].domain = [0, 0.92];
      layout[key.replace("yaxis", "legend")].y = 0.93;
    });
    layout.height = 270;
  }

  // where the paths of a figure are at a time: a trace each
  function dots(figure, time) {
    const row = Math.max(0, placeOf(data.time, time));
    return figure.traces.filter(over).map(({ x, y, xaxis, yaxis }) => ({
      x: [x[row]], y: [y[row]], xaxis, yaxis, mode: "markers", showlegend: false, hoverinfo: "skip",
      marker: { size: 10, color: "#000000", symbol: "circle-open", line: { width: 2 } },
    }));
  }

  const columns = figure => plane(figure) ? 3 : 1; // of plots on paper that a figure spans

  // a figure in the colors of the theme, showing one of its views
  function shown(figure) {
    const narrow = onPaper() || document.getElementById("plot-" + figure.name).clientWidth < NARROW;
    const layout = themed.layout(figure.layout, narrow && figure.traces.some(trace => trace.showlegend));
    if (onPaper()) layout.width = columns(figure) * PAPER;
    if (plane(figure)) arrange(layout, onPaper() ? layout.width : document.getElementById("plot-" + figure.name).clientWidth);
    const traces = figure.traces.map(trace => trace.edge ? edge(figure, trace) : trace).map(({ view, meta, ...trace }) => {
      // a narrow card has room for few and short entries of a key; that of 3 sigma stands above all plots, that of
      // ranges below, and final values are read by the cursor
      if (narrow && /^(3[- ]sigma|range of)/.test(trace.name)) trace.showlegend = false;
      if (narrow) trace.name = trace.name.replace(/, at the end .*/, "");
      const visible = trace.visible !== false && (view === undefined || (view === "log") === logarithmic);
      if (meta && meta.over) Object.assign(trace, { x: part(trace.x), y: part(trace.y) });
      return { x: data.time, ...themed.traces(trace), visible };
    });
    traces.push(...themed.traces(dots(figure, Number(slider.value))));
    for (const key of Object.keys(figure.views)) layout[key].type = logarithmic ? "log" : "linear";
    if (!plane(figure)) layout.xaxis.range = range.slice();
    for (const [key, value] of Object.entries(vertical(figure))) {
      const [axis, what] = key.split(".");
      layout[axis][what] = value;
    }
    return { traces, layout };
  }

  // ---- the cursor and what it reads

  function place(entry, time) {
    if (!entry.plot._fullLayout) return;
    if (plane(entry.figure)) {
      const now = dots(entry.figure, time), all = entry.figure.traces.length;
      Plotly.restyle(entry.plot, { x: now.map(dot => dot.x), y: now.map(dot => dot.y) }, now.map((_, number) => all + number));
      return;
    }
    const axis = entry.plot._fullLayout.xaxis, area = entry.plot._fullLayout._size;
    const x = axis._offset + axis.l2p(time);
    const inside = x >= axis._offset - 1 && x <= axis._offset + axis._length + 1;
    Object.assign(entry.line.style, { display: inside ? "block" : "none", left: entry.plot.offsetLeft + x + "px",
                                      top: entry.plot.offsetTop + area.t + "px", height: area.h + "px" });
    entry.line.dataset.time = time;
  }

  function number(value) {
    if (value === null || value === undefined) return "-";
    const size = Math.abs(value);
    if (size < 1e-30) return "0"; // a thrust that tails off never ends
    return size < 1e-3 || size >= 1e6 ? value.toExponential(3) : String(Number(value.toPrecision(5)));
  }

  // what a figure shows at a time: label, value and unit of each signal, in the order in which they are drawn
  function reading(figure, time) {
    const found = [], groups = new Map();
    for (const [place, trace] of figure.traces.entries()) {
      if (!trace.meta || trace.view === "log") continue;
      const { label, unit, bars, group, half } = trace.meta;
      if (over(trace)) {
        const at = Math.max(0, placeOf(data.time, time));
        found.push([over(trace)[0], number(trace.x[at]), over(trace)[1]], [label, number(trace.y[at]), unit]);
        continue;
      }
      if (bars) {
        const on = [];
        for (let start = 0; start < trace.x.length; start += 3) {
          if (trace.x[start] <= time + 1e-9 && time < trace.x[start + 1] - 1e-9) on.push(trace.text[start]);
        }
        if (on.length) groups.set(label, [...(groups.get(label) || []), ...on]);
        else if (!groups.has(label)) groups.set(label, []);
        continue;
      }
      const at = placeOf(times(trace), time);
      let value = at < 0 ? null : trace.y[at];
      if (half && value !== null) value = (value - figure.traces[place - 1].y[at]) / 2; // the lower edge stands before
      if (!group) { found.push([label, number(value), unit]); continue; }
      if (value !== null) groups.set(group, [...(groups.get(group) || []), [label, value, unit]]);
    }
    for (const [group, members] of groups) {
      if (members.length && Array.isArray(members[0])) {
        members.sort((one, other) => other[1] - one[1]);
        for (const [label, value, unit] of members.slice(0, 5)) found.push([label, number(value), unit]);
      } else found.push([group, members.length ? members.join(" ") : "none", ""]);
    }
    return found;
  }

  function read(entry, time) {
    entry.readout.replaceChildren(...reading(entry.figure, time).map(([label, value, unit]) => {
      const part = make("span");
      part.append(label ? label + " " : "", make("b", value), unit ? " " + unit : "");
      return part;
    }));
  }

  function cursor(time) {
    const now = Math.max(first, Math.min(last, time));
    slider.value = now;
    document.getElementById("cursor-time").textContent = now.toFixed(2) + " s";
    for (const entry of drawn) { place(entry, now); read(entry, now); }
  }

  // ---- zoom

  function zoomed(entry) {
    if (!plane(entry.figure) && !entry.figure.most.length) return Plotly.relayout(entry.plot, { "xaxis.range": range.slice(), "xaxis.autorange": false, ...vertical(entry.figure) });
    const drawing = shown(entry.figure);
    return Plotly.react(entry.plot, drawing.traces, drawing.layout, themed.options);
  }

  function zoom(from, to) {
    range = [Math.max(first, from), Math.min(last, to)];
    linking = true;
    return Promise.all(drawn.map(zoomed))
      .then(() => { linking = false; cursor(Number(slider.value)); });
  }

  function link(change) {
    if (linking) return;
    if (change["xaxis.range[0]"] !== undefined) zoom(change["xaxis.range[0]"], change["xaxis.range[1]"]);
    else if (change["xaxis.range"]) zoom(...change["xaxis.range"]);
    else if (change["xaxis.autorange"]) zoom(first, last);
  }

  function show(jump) {
    zoom(jump.start, jump.end).then(() => cursor(jump.at));
  }

  function jumps() {
    for (const jump of data.jumps) {
      const button = make("button", jump.text);
      button.type = "button";
      button.title = jump.start.toFixed(2) + " to " + jump.end.toFixed(2) + " s: " + jump.title;
      button.addEventListener("click", () => show(jump));
      document.getElementById("jumps").append(button);
    }
    document.querySelectorAll("button[data-jump]").forEach(button => button.addEventListener("click", () => {
      show(data.jumps[Number(button.dataset.jump)]);
      document.getElementById("bar").scrollIntoView();
    }));
  }

  // ---- figures

  const waiting = []; // figures that are not drawn yet
  function add(figure) {
    const card = make(figure.folded ? "details" : "section", "", "plot" + (plane(figure) ? " broad" : figure.folded ? " folded" : figure.layout.height > 560 ? " tall" : ""));
    const plot = make("div"), line = make("div", "", "cursor"), readout = make("p", "", "readout");
    card.id = "plot-" + figure.name;
    card.style.setProperty("--rows", Math.ceil(figure.layout.height / ROW));
    if (figure.folded) {
      const summary = make("summary");
      summary.append(make("h3", figure.title));
      card.append(summary);
    } else card.append(make("h3", figure.title));
    card.append(readout, plot);
    if (figure.note) card.append(make("p", figure.note, "note"));
    plot.style.minHeight = figure.folded || plane(figure) ? "" : figure.layout.height + "px";
    host.append(card);
    const entry = { figure, plot, line, readout };
    const begin = () => {
      const drawing = shown(figure);
      if (!plane(figure)) plot.after(line);
      return Plotly.newPlot(plot, drawing.traces, drawing.layout, themed.options).then(() => {
        drawn.push(entry);
        if (plane(figure)) {
          plot.on("plotly_hover", ({ points: [at] }) => { if (over(figure.traces[at.curveNumber] || {})) cursor(data.time[at.pointNumber]); });
          read(entry, Number(slider.value));
          return;
        }
        plot.on("plotly_hover", event => cursor(event.points[0].x));
        plot.on("plotly_relayout", link);
        plot.on("plotly_afterplot", () => place(entry, Number(slider.value)));
        place(entry, Number(slider.value));
        read(entry, Number(slider.value));
      });
    };
    if (figure.folded) card.addEventListener("toggle", begin, { once: true });
    else waiting.push({ card, begin });
  }

  // the plot that shows a failure best, about the first one, above all others
  async function failing() {
    const figure = data.plots.find(({ name }) => name === data.failing), jump = data.jumps[0];
    if (!figure) return;
    const place = document.getElementById("failing"), card = make("section", "", "failing"), plot = make("div");
    place.hidden = false;
    card.append(make("h3", figure.title + ", " + jump.text + ": " + jump.title), plot);
    place.append(card);
    const draw = () => {
      const now = range;
      range = [jump.start, jump.end];
      const { traces, layout } = shown(figure);
      range = now;
      return Plotly.react(plot, traces, layout, themed.options);
    };
    themed.onChange(draw);
    await draw();
  }

  // the next figure to draw: the nearest to the window, and whether it is in it
  function next() {
    const far = waiting.map(({ card }) => { const box = card.getBoundingClientRect(); return Math.max(0, box.top - innerHeight, -box.bottom); });
    const least = Math.min(...far);
    return { inWindow: least === 0, begin: waiting.splice(far.indexOf(least), 1)[0].begin };
  }

  // lets the browser do what the reader asks for before a figure is drawn that is not in the window
  const idle = () => new Promise(done => window.requestIdleCallback ? requestIdleCallback(done, { timeout: 200 }) : setTimeout(done, 20));
  const painted = () => new Promise(done => setTimeout(done));

  function redraw() {
    for (const entry of drawn) {
      const drawing = shown(entry.figure);
      Plotly.react(entry.plot, drawing.traces, drawing.layout, themed.options);
    }
  }

  slider.min = first; slider.max = last; slider.value = first;
  slider.addEventListener("input", () => cursor(Number(slider.value)));
  document.getElementById("zoom-out").addEventListener("click", () => zoom(first, last));
  document.getElementById("views").addEventListener("click", event => {
    logarithmic = !logarithmic;
    event.target.textContent = "Errors: " + (logarithmic ? "logarithmic" : "linear");
    event.target.setAttribute("aria-pressed", String(logarithmic));
    redraw();
  });
  themed.onChange(redraw);
  addEventListener("resize", () => requestAnimationFrame(() => {
    for (const entry of drawn) if (plane(entry.figure)) zoomed(entry);
    cursor(Number(slider.value));
  }));
  // on paper in the colors of paper, and as wide as it
  const narrowed = width => Promise.all(drawn.map(entry => Plotly.relayout(entry.plot, { width: width && columns(entry.figure) * width, autosize: width === undefined })));
  addEventListener("beforeprint", () => { document.documentElement.dataset.print = "yes"; waiting.splice(0).forEach(({ begin }) => begin()); redraw(); narrowed(PAPER); });
  addEventListener("afterprint", () => { delete document.documentElement.dataset.print; redraw(); narrowed(undefined); });
  jumps();

  (async () => {
    data.plots.forEach(add);
    await failing();
    await painted();
    while (waiting.length) {
      const { inWindow, begin } = next();
      if (!inWindow) document.body.dataset.shown = "yes";
      await begin();
      await (inWindow ? painted : idle)();
    }
    cursor(Number(slider.value));
    document.body.dataset.shown = "yes";
    document.body.dataset.ready = "yes";
  })();
  window.massprop = { cursor, zoom, reading, figures: data.plots };
})();
