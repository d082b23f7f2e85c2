// The part of the time that is shown: the same in all panels along time, changed by mouse, touch and keyboard.

const whole = [data.series.start[0], data.series.start[data.series.start.length - 1] + data.series.width];
const least = Math.min(3 * data.step, whole[1] - whole[0]);
let span = whole.slice();
const spanWords = () => {
  const name = (at) => (data.timed ? stamp(Math.round(at / 1e3) * 1e3) : nameOf(nearest(Math.min(Math.floor(at), records.position[n - 1]))).replace(/ UTC$/, ""));
  const end = data.timed ? span[1] : span[1] - 1;
  return `${name(span[0])} to ${name(end)}${data.timed ? " UTC" : ""}${span[0] === whole[0] && span[1] === whole[1] ? " (all)" : ""}`;
};
const timeFigures = () => document.querySelectorAll("[data-time]");
let waiting = 0;
const redrawTime = () => {
  waiting = 0;
  timeFigures().forEach((holder) => draw(holder));
  placeWindow();
};
/** Show another part of the time; what is asked for beyond the ends is moved inside. */
const setSpan = (low, high) => {
  const width = Math.min(Math.max(high - low, least), whole[1] - whole[0]);
  const middle = (low + high) / 2;
  const first = Math.min(Math.max(middle - width / 2, whole[0]), whole[1] - width);
  span = width >= whole[1] - whole[0] ? whole.slice() : [first, first + width];
  if (!waiting) waiting = requestAnimationFrame(redrawTime);
};
const zoom = (factor, at = (span[0] + span[1]) / 2) => setSpan(at - (at - span[0]) * factor, at + (span[1] - at) * factor);
const pan = (share) => setSpan(span[0] + share * (span[1] - span[0]), span[1] + share * (span[1] - span[0]));
const showAll = () => setSpan(...whole);

/** The axis of time of a panel: so that a pointer's place can be told. */
const timeAt = (svg, clientX) => {
  const { left, right, width } = svg.timeAxis;
  const place = svg.getBoundingClientRect();
  return span[0] + ((clientX - place.left) * width / place.width - left) / (right - left) * (span[1] - span[0]);
};
/** Give a panel its axis of time, and the rectangle that a brush moves. */
const alongTime = (svg, box, width) => {
  svg.timeAxis = { left: box.left, right: box.right, width };
  svg.classList.add("pickable");
  const brush = element("rect", { class: "brush", y: box.top, height: box.bottom - box.top, x: box.left, width: 0 });
  svg.brush = brush;
  svg.append(brush);
};
const placeBrush = (from, to) => timeFigures().forEach((holder) => holder.querySelectorAll("svg").forEach((svg) => {
  if (!svg.timeAxis) return;
  const x = scale(span, [svg.timeAxis.left, svg.timeAxis.right]);
  const [low, high] = [Math.max(Math.min(from, to), span[0]), Math.min(Math.max(from, to), span[1])];
  svg.brush.setAttribute("x", x(low));
  svg.brush.setAttribute("width", Math.max(0, round(x(high) - x(low))));
}));
/** Drag to zoom, two fingers to stretch, a click to choose, two clicks for all. */
const listenToTime = (holder, hovered, picked) => {
  const fingers = new Map();
  const panelOf = (index) => holder.querySelectorAll("svg")[index];
  let brushed = false;
  holder.addEventListener("pointerdown", (event) => {
    const svg = event.target.closest("svg");
    if (event.button !== 0 || !svg || !svg.timeAxis) return;
    holder.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { panel: [...holder.querySelectorAll("svg")].indexOf(svg), from: timeAt(svg, event.clientX), x: event.clientX, start: event.clientX });
    brushed = fingers.size > 1;
    if (brushed) placeBrush(span[0], span[0]);
  });
  holder.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) {
      const svg = event.target.closest("svg");
      if (svg && svg.timeAxis && fingers.size === 0) hovered(timeAt(svg, event.clientX));
      return;
    }
    finger.x = event.clientX;
    if (fingers.size === 1 && !brushed && Math.abs(finger.x - finger.start) > 4) {
      placeBrush(finger.from, timeAt(panelOf(finger.panel), finger.x));
    } else if (fingers.size === 2) {
      const [one, two] = [...fingers.values()];
      const svg = panelOf(one.panel);
      const { left, right, width } = svg.timeAxis;
      const place = svg.getBoundingClientRect();
      const slope = (two.from - one.from) / (two.x - one.x || 1) * place.width / width; // time a unit of the drawing
      const first = one.from - slope * ((one.x - place.left) * width / place.width - left);
      if (slope > 0) setSpan(first, first + slope * (right - left));
    }
  });
  const lifted = (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    fingers.delete(event.pointerId);
    if (brushed) return;
    placeBrush(span[0], span[0]);
    if (event.type !== "pointerup") return;
    const at = timeAt(panelOf(finger.panel), event.clientX);
    if (Math.abs(event.clientX - finger.start) > 4) setSpan(Math.min(at, finger.from), Math.max(at, finger.from));
    else picked(at);
  };
  holder.addEventListener("pointerup", lifted);
  holder.addEventListener("pointercancel", lifted);
  holder.addEventListener("pointerleave", () => hovered(null));
  holder.addEventListener("dblclick", showAll);
  holder.addEventListener("wheel", (event) => {
    const svg = event.target.closest("svg");
    if (!event.ctrlKey || !svg || !svg.timeAxis) return; // a plain wheel scrolls the page
    event.preventDefault();
    zoom(Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY / 100))), timeAt(svg, event.clientX));
  }, { passive: false });
};

// ---- the strip above the panels: all of the time, and what of it is shown

const strip = document.getElementById("strip");
const placeWindow = () => {
  if (!strip) return;
  strip.setAttribute("aria-valuenow", String(Math.round(50 * (span[0] + span[1] - 2 * whole[0]) / (whole[1] - whole[0]))));
  strip.setAttribute("aria-valuetext", spanWords());
  document.getElementById("span").textContent = spanWords();
  const turbine = document.getElementById("turbine");
  if (turbine) {
    const shownOnly = records.turbine.names.findIndex((_, index) => String(turbineSpan(index)) === String(span));
    turbine.value = shownOnly < 0 ? "" : String(shownOnly);
  }
  const shown = strip.querySelector(".shown");
  if (!shown) return;
  const x = scale(whole, [strip.left, strip.right]);
  shown.setAttribute("x", x(span[0]));
  shown.setAttribute("width", Math.max(2, round(x(span[1]) - x(span[0]))));
};
const drawStrip = () => {
  if (!strip) return;
  const width = strip.clientWidth;
  if (width < 50) return;
  const [left, right, height] = [46, width - 18, 44];
  const svg = picture(width, height, "All of the time, and the part that is shown", "The line is the first panel's median.");
  const x = scale(whole, [left, right]);
  const middle = (data.series.ti || data.series).median;
  const values = data.series.ti ? middle : middle[0];
  const known = finite(values);
  const y = scale(known.length ? extent(known) : [0, 1], [height - 6, 6]);
  let line = "";
  let pen = "M";
  values.forEach((value, k) => {
    if (value === null || (k && ofTwo(...[k - 1, k].map((one) => data.series.start[one] + data.series.width / 2)))) pen = "M";
    if (value === null) return;
    line += `${pen}${x(data.series.start[k] + data.series.width / 2)} ${y(value)}`;
    pen = "L";
  });
  svg.append(path(`M${left} 2H${right}V${height - 2}H${left}Z`, "frame"), path(line || "M0 0", "middle thin"),
    element("rect", { class: "shown", x: left, y: 2, width: right - left, height: height - 4 }));
  Object.assign(strip, { left, right, unitWidth: width });
  strip.replaceChildren(svg);
  placeWindow();
};
if (strip) {
  const at = (event) => {
    const place = strip.getBoundingClientRect();
    return whole[0] + ((event.clientX - place.left) * strip.unitWidth / place.width - strip.left) / (strip.right - strip.left) * (whole[1] - whole[0]);
  };
  let grip = null; // within the window: it is moved; outside: a new one is drawn
  strip.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    strip.setPointerCapture(event.pointerId);
    const inside = at(event) >= span[0] && at(event) <= span[1] && span[1] - span[0] < whole[1] - whole[0];
    grip = { from: at(event), x: event.clientX, span: inside ? span.slice() : null };
  });
  strip.addEventListener("pointermove", (event) => {
    if (!grip || Math.abs(event.clientX - grip.x) < 3) return;
    const moved = at(event) - grip.from;
    if (grip.span) setSpan(grip.span[0] + moved, grip.span[1] + moved);
    else setSpan(Math.min(grip.from, at(event)), Math.max(grip.from, at(event)));
  });
  strip.addEventListener("pointerup", (event) => {
    if (grip && Math.abs(event.clientX - grip.x) < 3) {
      const half = (span[1] - span[0]) / 2;
      setSpan(at(event) - half, at(event) + half);
    }
    grip = null;
  });
  strip.addEventListener("pointercancel", () => { grip = null; });
  strip.addEventListener("dblclick", showAll);
  const keys = {
    ArrowLeft: () => pan(-0.25), ArrowRight: () => pan(0.25), PageUp: () => pan(-1), PageDown: () => pan(1),
    Home: () => setSpan(whole[0], whole[0] + span[1] - span[0]), End: () => setSpan(whole[1] - span[1] + span[0], whole[1]),
    "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), Escape: showAll, 0: showAll,
  };
  strip.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  const buttons = { "zoom-in": () => zoom(0.5), "zoom-out": () => zoom(2), earlier: () => pan(-0.5), later: () => pan(0.5), all: showAll };
  Object.entries(buttons).forEach(([id, act]) => document.getElementById(id).addEventListener("click", act));
  const turbine = document.getElementById("turbine");
  if (turbine) {
    turbine.addEventListener("input", () => {
      if (turbine.value === "") { showAll(); return; }
      setSpan(...turbineSpan(Number(turbine.value)));
    });
  }
}
