// The page of a fit: draws its figures, and shows the record that is chosen.

const figures = {
  availability, stresses, decided, budget, intensity, corner, shape, diagnostics, beside, acceptance,
  "campaign-means": campaignMeans, "campaign-speed": campaignSpeed, "campaign-hyper": campaignHyper,
};
const holders = [...document.querySelectorAll("[data-figure]")];
const widths = new Map();
const draw = (holder) => {
  const width = holder.clientWidth;
  if (width < 50) return;
  widths.set(holder, width);
  holder.replaceChildren();
  figures[holder.dataset.figure](holder, width);
};
const picker = document.getElementById("pick");
const show = () => {
  document.querySelectorAll("[data-mark]").forEach((mark) => mark.place());
  const said = document.getElementById("chosen");
  if (!said) return;
  const speed = records.speed[chosen];
  const flags = flagsOf(chosen);
  said.textContent = `${nameOf(chosen)}${Number.isFinite(startOf(chosen)) ? `, record ${records.number[chosen]}` : ""}` +
    `${Number.isFinite(speed) ? `; mean wind ${written(speed)} m/s` : ""}; ${flags.length ? `flags: ${flags.join(", ")}` : "no flag"}.`;
  cornerWords();
  chosenTable();
};
const addressOf = (place) => {
  const start = startOf(place);
  if (!Number.isFinite(start)) return `#record-${records.number[place]}`;
  return `#${turbineOf(place) ? `${encodeURIComponent(turbineOf(place))}/` : ""}${isoOf(start)}`;
};
/** The place of the record that an address asks for, or why there is none. */
const findRecord = ({ turbine, ms, number }) => {
  const there = (place) => !turbine || turbineOf(place) === turbine;
  if (number !== undefined) {
    const place = records.number.indexOf(number);
    return place >= 0 ? place : `There is no record ${number} in this page.`;
  }
  if (turbine && !(records.turbine && records.turbine.names.includes(turbine))) return `There is no turbine ${turbine} in this page.`;
  let best = -1;
  for (let place = 0; place < n; place += 1) {
    if (there(place)) {
      const late = ms - startOf(place);
      if (late >= 0 && late < data.duration) return place;
      if (Number.isFinite(late) && (best < 0 || Math.abs(late) < Math.abs(ms - startOf(best)))) best = place;
    }
  }
  if (best < 0) return "The records of this page have no times: write #record-12 for one of them.";
  return `No record here holds ${stamp(ms)} UTC; the nearest begins at ${nameOf(best)}.`;
};
/** Choose a record; one that a person chose gets its address, and comes into sight. */
const choose = (place, { told = false } = {}) => {
  chosen = Math.max(0, Math.min(n - 1, place));
  if (picker) {
    if (picker.tagName === "SELECT") picker.value = String(chosen);
    else if (picker.type === "number") picker.value = String(records.number[chosen]);
    else picker.value = new Date(records.position[chosen]).toISOString().slice(0, 19);
  }
  if (!told) writeAddress(addressOf(chosen));
  const position = records.position[chosen];
  if ((position < span[0] || position >= span[1]) && records.turbine && !data.timed) {
    setSpan(...turbineSpan(records.turbine.place[chosen]));
  } else if (position < span[0] || position >= span[1]) {
    const half = (span[1] - span[0]) / 2;
    setSpan(position + step / 2 - half, position + step / 2 + half);
  }
  show();
  holders.filter((holder) => holder.dataset.figure === "corner").forEach(draw);
};
holders.forEach(draw);
drawStrip();
show();
timeFigures().forEach((holder) => listenToTime(
  holder,
  holder.dataset.figure === "stresses" ? hoverStresses : () => {},
  (at) => choose(recordAt(at)),
));
if (picker) {
  picker.addEventListener(picker.tagName === "SELECT" ? "input" : "change", () => {
    if (picker.tagName === "SELECT") choose(Number(picker.value));
    else if (picker.value !== "") choose(nearest(picker.type === "number" ? Number(picker.value) : Date.parse(`${picker.value}Z`)));
  });
  document.getElementById("previous").addEventListener("click", () => choose(chosen - 1));
  document.getElementById("next").addEventListener("click", () => choose(chosen + 1));
  const flagged = document.getElementById("next-flagged");
  flagged.disabled = !records.flag.some((flag) => flag > 0);
  flagged.addEventListener("click", () => {
    for (let k = 1; k <= n; k += 1) {
      if (records.flag[(chosen + k) % n] > 0) {
        choose((chosen + k) % n);
        return;
      }
    }
  });
}
followAddress(findRecord, (place) => {
  choose(place, { told: true });
  const section = document.getElementById("record") || document.getElementById("stresses");
  if (section) section.scrollIntoView();
});
new ResizeObserver(() => {
  holders.forEach((holder) => { if (Math.abs(holder.clientWidth - (widths.get(holder) || 0)) > 1) draw(holder); });
  if (strip && Math.abs(strip.clientWidth - (strip.unitWidth || 0)) > 1) drawStrip();
}).observe(document.body);
