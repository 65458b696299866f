(function () {
  "use strict";
  const element = id => document.getElementById(id);
  const story = JSON.parse(element("data").textContent), scene = story.scene, rows = story.rows;
  const column = Object.fromEntries(story.columns.map((name, index) => [name, index]));
  const at = (row, name) => rows[row][column[name]];
  const structure = ["world", "body", "structure"];
  const node = (...path) => viewer.scene_tree.find(path).object;
  const rgb = color => [1, 3, 5].map(start => parseInt(color.slice(start, start + 2), 16) / 255);
  let first = 0, last = 0, following = story.live;
  const gaps = new Set(story.gaps);
  const slider = element("mp-slider"), button = element("mp-play"), speed = element("mp-speed");
  let playing = false, now = 0, stamp = null, ready = false, shownRow = -1, pointer = null;

  function keys() {
    const words = [["given", "thrust"], ["untold", "thrust of a failed jet, untold"], ["withheld", "told to fire, and does not"],
                   ["truth", "true center of mass"], ["estimate", "estimated, with its 3-sigma"],
                   ["failed", "failed jet"], ["found", "found by the detector"], ["payload", "payload"], ["path", "flown path"]];
    const seen = name => story.live && name !== "payload" ? true : story.lists[name] ? story.lists[name].some(jets => jets.length) : name === "payload" ? scene.payloads.length : true;
    for (const [name, text] of words) {
      if (name === "truth" && !story.truth || name === "path" && !("position" in column) || !seen(name)) continue;
      const item = document.createElement("span"), dot = document.createElement("i");
      dot.style.background = story.colors[name];
      item.append(dot, text);
      element("mp-keys").append(item);
    }
  }

  function ticks() {
    element("mp-events").replaceChildren();
    for (const event of story.events) {
      const tick = document.createElement("button");
      tick.type = "button";
      tick.title = event.at.toFixed(2) + " s: " + event.text;
      tick.setAttribute("aria-label", tick.title);
      tick.style.left = 100 * (event.at - first) / Math.max(last - first, 1e-9) + "%";
      tick.style.setProperty("--of", story.colors[event.kind]);
      tick.addEventListener("click", () => { playing = following = false; seek(event.at); });
      element("mp-events").append(tick);
    }
  }

  // the last row at or before a time
  function rowAt(time) {
    let low = 0, high = rows.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (at(middle, "time") <= time + 1e-9) low = middle; else high = middle - 1;
    }
    return low;
  }

  function turn(row) {
    const body = node("world", "body"), [w, x, y, z] = at(row, "attitude");
    const goesOn = row + 1 < rows.length && !gaps.has(row) && !gaps.has(row + 1), from = at(row, "time");
    const share = goesOn ? Math.max(0, now - from) / (at(row + 1, "time") - from) : 0;
    body.quaternion.set(x, y, z, w);
    if (goesOn) {
      const [w2, x2, y2, z2] = at(row + 1, "attitude");
      body.quaternion.slerp(body.quaternion.clone().set(x2, y2, z2, w2), share);
    }
    if ("position" in column) fly(row, at(row, "position"), goesOn ? at(row + 1, "position") : at(row, "position"), share);
    if ("links" in column) links(at(row, "links"), goesOn ? at(row + 1, "links") : at(row, "links"), share);
  }

  // the path that has been flown, and the floor, go by: the center of mass stays in the middle
  function fly(row, here, next, share) {
    const gone = here.map((value, axis) => -(value + share * (next[axis] - value)));
    const path = node("world", "path"), floor = node("world", "floor");
    path.position.set(...gone);
    path.traverse(part => { if (part.geometry) part.geometry.setDrawRange(0, row + 1 + (share > 0)); });
    if (floor) floor.position.set(gone[0] % scene.axis, gone[1] % scene.axis, 0);
  }

  // poses of a model's links in the vehicle frame, seven numbers each
  function links(here, next, share) {
    for (let first = 0; first < here.length; first += 7) {
      const link = node(...structure, "links", String(first / 7));
      const [x, y, z, qw, qx, qy, qz] = here.slice(first, first + 7), [x2, y2, z2, w2, i2, j2, k2] = next.slice(first, first + 7);
      link.position.set(x + share * (x2 - x), y + share * (y2 - y), z + share * (z2 - z));
      link.quaternion.set(qx, qy, qz, qw);
      link.quaternion.slerp(link.quaternion.clone().set(i2, j2, k2, w2), share);
    }
  }

  const state = scene.jets.map(() => ""), sizes = scene.jets.map(() => 1);
  function jets(row) {
    const wanted = scene.jets.map(() => ""), size = scene.jets.map(() => 1);
    for (const kind of ["given", "untold", "withheld"]) for (const jet of story.lists[kind][row]) wanted[jet] = kind;
    [...story.lists.given[row], ...story.lists.untold[row]].forEach((jet, number) => { size[jet] = story.lists.sizes[row][number]; });
    wanted.forEach((kind, jet) => {
      if (kind === state[jet] && size[jet] === sizes[jet]) return;
      state[jet] = kind;
      sizes[jet] = size[jet];
      const plume = [...structure, "jets", String(jet), "plume"];
      node(...plume).scale.setScalar(size[jet]);  // by the true thrust: a leak is smaller than a full jet
      viewer.set_property(plume, "visible", kind !== "");
      if (kind) viewer.set_property(plume, "color", [...rgb(story.colors[kind]), kind === "withheld" ? 0.3 : 0.75]);
    });
    for (const kind of ["failed", "found"]) {
      const marked = new Set(story.lists[kind][row]);
      scene.jets.forEach((_, jet) => { node(...structure, "marks", kind + jet).visible = marked.has(jet); });
    }
  }

  function light(id, text, level) {
    element(id).textContent = text;
    element(id).className = level;
  }
  const grade = (value, [doubt, bad]) => value > bad ? "bad" : value > doubt ? "doubt" : "good";

  function instruments(row) {
    const signed = value => value === null ? "-" : (value < 0 ? "−" : "+") + Math.abs(value).toFixed(3);
    element("mp-rate").textContent = at(row, "rate").map(signed).join("  ");
    const firing = [...story.lists.given[row], ...story.lists.untold[row]].map(jet => scene.jets[jet].name);
    element("mp-jets").textContent = firing.length ? firing.join(" ") : "none";
    const used = [];
    for (let back = row; back >= 0 && used.length < story.limits.nis_window; back--) if (at(back, "nis") !== null) used.push(at(back, "nis"));
    const mean = used.reduce((sum, value) => sum + value, 0) / used.length;
    if (used.length < story.limits.nis_window) light("mp-nis", "not enough samples", "");
    else light("mp-nis", "mean NIS " + mean.toPrecision(3), grade(mean, story.limits.nis));
    const apart = at(row, "apart");
    if (gaps.has(row)) light("mp-apart", "no telemetry", "doubt");
    else if (!story.limits.apart) light("mp-apart", "one of a kind", "");
    else if (apart === null) light("mp-apart", "-", "");
    else light("mp-apart", apart.toFixed(1) + " sigma apart", grade(apart, story.limits.apart));
  }

  function say() {
    const moment = story.moments.filter(one => one.at <= now + 1e-9).pop() || story.moments[0];
    const row = rowAt(now), found = story.live ? story.lists.found[row].map(jet => "jet " + scene.jets[jet].name) : moment.found;
    const words = [["", moment.command], ...moment.failed.map(text => ["failed", "failed: " + text]), ...found.map(text => ["found", "found: " + text])];
    element("mp-now").replaceChildren(...words.filter(([, text]) => text).map(([kind, text]) => {
      const part = document.createElement("span");
      part.className = kind;
      part.textContent = text;
      return part;
    }));
    element("mp-time").textContent = now.toFixed(2) + " s";
    slider.value = now;
    button.textContent = playing || following ? "Pause" : "Play";
  }

  function show() {
    const row = rowAt(now);
    turn(row);
    if (row !== shownRow) {
      shownRow = row;
      node(...structure).position.set(...at(row, "center").map(value => -value));
      const spread = at(row, "deviation").map(value => Math.max(scene.spread[0], Math.min(scene.spread[1], 3 * (value || 0))));
      node(...structure, "estimate").position.set(...at(row, "estimate").map(value => value || 0));
      node(...structure, "estimate", "spread").scale.set(...spread);
      jets(row);
      instruments(row);
    }
    scene.payloads.forEach(({ at: time, docks }, number) => {
      node(...structure, "payloads", String(number)).visible = (now >= time - 1e-9) === docks;
    });
    viewer.set_dirty();
    say();
  }
  function seek(time) {
    now = Math.max(first, Math.min(last, time));
    show();
  }
  function toggle() {
    if (following) following = false;
    else playing = !playing;
    if (playing && now >= last) { if (story.live) { playing = false; following = true; } else now = first; }
    stamp = null;
    show();
  }

  // ---- what is written over the picture
  const axes = ["x", "y", "z"].map(letter => {
    const label = document.createElement("span");
    label.textContent = letter === "x" ? letter + "  " + scene.axis + " " + scene.unit : letter;
    element("mp-labels").append(label);
    return label;
  });
  function onScreen(object, x, y, z) {
    object.updateWorldMatrix(true, false);
    const place = viewer.camera.position.clone().set(x, y, z).applyMatrix4(object.matrixWorld).project(viewer.camera);
    const pane = element("meshcat-pane").getBoundingClientRect();
    return [pane.left + (place.x + 1) / 2 * pane.width, pane.top + (1 - place.y) / 2 * pane.height];
  }
  function label() {
    axes.forEach((mark, axis) => {
      const [x, y] = onScreen(node("world", "body"), ...[0, 1, 2].map(each => each === axis ? 1.06 * scene.axis : 0));
      mark.style.left = x + "px";
      mark.style.top = y + "px";
    });
    const hover = element("mp-hover");
    let nearest = null, least = 14;
    if (pointer) scene.jets.forEach((jet, index) => {
      const [x, y] = onScreen(node(...structure), ...jet.place), distance = Math.hypot(x - pointer[0], y - pointer[1]);
      if (distance < least) { least = distance; nearest = index; }
    });
    hover.hidden = nearest === null;
    if (nearest === null) return;
    const words = { "": "quiet", given: "fires", untold: "fires untold", withheld: "told to fire, and does not" };
    hover.textContent = scene.jets[nearest].name + ", cluster " + scene.jets[nearest].cluster + ": " + words[state[nearest]];
    hover.style.left = Math.min(pointer[0] + 12, innerWidth - hover.offsetWidth - 4) + "px";
    hover.style.top = pointer[1] + 12 + "px";
  }

  // the whole vehicle fits, in a wide window and on a phone, until the reader moves the camera
  const standing = viewer.camera.position.clone();
  let moved = false;
  function frame() {
    const aspect = innerWidth / innerHeight, half = viewer.camera.fov * Math.PI / 360;
    if (!moved) viewer.camera.position.copy(standing).multiplyScalar(Math.sin(half) / Math.sin(Math.atan(Math.tan(half) * Math.min(1, aspect))));
    viewer.set_dirty();
  }

  function dress() {
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    viewer.set_property(["Background", "<object>"], "top_color", dark ? [0.16, 0.19, 0.24] : [0.93, 0.95, 0.98]);
    viewer.set_property(["Background", "<object>"], "bottom_color", dark ? [0.07, 0.09, 0.12] : [0.75, 0.79, 0.85]);
    viewer.set_dirty();
  }

  function begin() {
    ready = true;
    first = at(0, "time");
    last = at(rows.length - 1, "time");
    standing.copy(viewer.camera.position);
    slider.min = first;
    slider.max = last;
    keys();
    ticks();
    dress();
    frame();
    const asked = Number(new URLSearchParams(location.hash.slice(1)).get("t") ?? NaN);
    seek(Number.isFinite(asked) ? asked : following ? last : first);
    document.body.dataset.ready = "yes";
  }
  // the scene is a number of orders, which are carried out one after the other
  function listen() {
    const source = new EventSource("/rows");
    source.onmessage = message => {
      const { row, lists } = JSON.parse(message.data);
      rows.push(row);
      for (const [name, jets] of Object.entries(lists)) {
        const before = story.lists[name].at(-1) || [], fresh = jets.filter(jet => !before.includes(jet));
        if (fresh.length && (name === "failed" || name === "found"))
          story.events.push({ at: row[column.time], kind: name, text: (name === "failed" ? "fails: " : "taken out of use: ") + fresh.map(jet => "jet " + scene.jets[jet].name).join(", ") });
        story.lists[name].push(jets);
      }
      if (!ready) return;
      last = slider.max = row[column.time];
      if (story.events.length) ticks();
      if (following) seek(last);
    };
    source.onerror = () => { source.close(); following = false; if (ready) say(); };  // the run has ended: what has been seen stays
  }
  if (story.live) listen();

  let orders = 0;
  const obey = viewer.handle_command_bytearray.bind(viewer);
  viewer.handle_command_bytearray = order => { obey(order); orders++; };

  function step(time) {
    if (!ready && rows.length && orders >= scene.commands) begin();
    if (ready && playing) {
      if (stamp !== null) seek(now + Number(speed.value) * (time - stamp) / 1000);
      stamp = time;
      if (now >= last) { playing = false; show(); }
    }
    if (ready) label();
    requestAnimationFrame(step);
  }
  button.addEventListener("click", toggle);
  slider.addEventListener("input", () => { playing = following = false; seek(Number(slider.value)); });
  addEventListener("hashchange", () => seek(Number(new URLSearchParams(location.hash.slice(1)).get("t") ?? now)));
  addEventListener("resize", frame);
  element("meshcat-pane").addEventListener("pointerdown", () => { moved = true; });
  element("meshcat-pane").addEventListener("wheel", () => { moved = true; });
  addEventListener("pointermove", event => { pointer = event.target.closest("#meshcat-pane") ? [event.clientX, event.clientY] : null; });
  addEventListener("pointerdown", event => { pointer = event.target.closest("#meshcat-pane") ? [event.clientX, event.clientY] : null; });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", dress);
  document.addEventListener("keydown", event => {
    if (event.target.matches("input, select, button")) return;
    if (event.key === " ") { event.preventDefault(); toggle(); }
    if (event.key === "ArrowRight") seek(now + 0.5);
    if (event.key === "ArrowLeft") seek(now - 0.5);
  });
  window.massprop = { seek, toggle, time: () => now, node, onScreen };
  requestAnimationFrame(step);
})();
