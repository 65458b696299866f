(function () {
  "use strict";
  const element = id => document.getElementById(id);
  const story = JSON.parse(element("data").textContent);
  const keys = [["plume", "thrust"], ["truth", "true center of mass"], ["estimate", "estimated, with its 3-sigma"],
                ["failed", "failed jet"], ["found", "found by the detector"]];
  for (const [key, words] of keys) {
    if (key === "truth" && !story.truth) continue;
    const item = document.createElement("span"), dot = document.createElement("i");
    dot.style.background = story.colors[key];
    item.append(dot, words);
    element("mp-keys").append(item);
  }
  const slider = element("mp-slider"), button = element("mp-play"), speed = element("mp-speed");
  let playing = false, now = 0, last = null, ready = false;
  function show() {
    const moment = story.moments.filter(m => m.at <= now + 1e-6).pop() || story.moments[0];
    const words = [moment.command, ...moment.failed.map(t => "failed: " + t), ...moment.found.map(t => "found: " + t)];
    element("mp-now").textContent = words.filter(Boolean).join("   |   ");
    element("mp-time").textContent = (story.start_s + now).toFixed(2) + " s";
    slider.value = now;
    button.textContent = playing ? "Pause" : "Play";
  }
  function seek(time) {
    now = Math.max(0, Math.min(viewer.animator.duration, time));
    viewer.animator.seek(now);
    show();
  }
  function toggle() {
    playing = !playing;
    if (playing && now >= viewer.animator.duration) seek(0);
    last = null;
    show();
  }
  function step(stamp) {
    if (!ready && viewer.animator.duration > 0) {
      ready = true;
      viewer.animator.pause();
      slider.max = viewer.animator.duration;
      seek(0);
      document.body.dataset.ready = "yes";
    }
    if (ready && playing) {
      if (last !== null) seek(now + Number(speed.value) * (stamp - last) / 1000);
      last = stamp;
      if (now >= viewer.animator.duration) { playing = false; show(); }
    }
    requestAnimationFrame(step);
  }
  button.addEventListener("click", toggle);
  slider.addEventListener("input", () => { playing = false; seek(Number(slider.value)); });
  document.addEventListener("keydown", event => {
    if (event.target.matches("input, select, button")) return;
    if (event.key === " ") { event.preventDefault(); toggle(); }
    if (event.key === "ArrowRight") seek(now + 0.5);
    if (event.key === "ArrowLeft") seek(now - 0.5);
  });
  window.massprop = { seek, toggle, time: () => now };
  requestAnimationFrame(step);
})();
