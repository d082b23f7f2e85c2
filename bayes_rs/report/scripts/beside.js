// Two fits of the same records: medians and intervals beside each other, and where the intervals do not overlap.

const besideRecords = data.beside ? {
  place: Int32Array.from(new Uint32Array(bytes(data.beside.place))),
  numbers: rowsOf(data.beside.numbers),
  priors: new Uint8Array(bytes(data.beside.priors)),
  apart: new Uint8Array(bytes(data.beside.apart)),
} : null;
/** Medians over so many neighbours that a panel has at most 600 points: where they stand, of both fits, and whose they are. */
const besideGroups = (rows) => {
  const size = Math.ceil(rows.length / 600) || 1;
  const groups = Array.from({ length: Math.ceil(rows.length / size) }, (_, k) => rows.slice(k * size, (k + 1) * size));
  const group = (some, numbers) => {
    const all = some.map(numbers);
    return ["median", "low", "high"].map((kind) => data.stresses.map((_, c) => medianOf(finite(all.map((one) => one[kind][c])))));
  };
  const most = (some, priors) => data.stresses.map((_, c) => (2 * some.filter((k) => (priors(k) >> c) & 1).length > some.length ? 1 : 0));
  return {
    gap: 1.5 * step * size,
    centre: groups.map((some) => (records.position[besideRecords.place[some[0]]] + records.position[besideRecords.place[some[some.length - 1]]] + step) / 2),
    ours: groups.map((some) => group(some, (k) => numbersOf(besideRecords.place[k]))),
    theirs: groups.map((some) => group(some, (k) => {
      const [median, low, high] = [0, 6, 12].map((offset) => unpacked(besideRecords.numbers, k, 6, offset));
      return { median, low, high };
    })),
    kinds: [(k) => records.priors[besideRecords.place[k]], (k) => besideRecords.priors[k]].map((priors) => groups.map((some) => most(some, priors))),
  };
};
let besideWhole = null; // of very many records the groups stay those of the whole: they are made once
const beside = (holder, full) => {
  const width = panelWidth(holder, full);
  const every = Array.from(besideRecords.place, (_, k) => k);
  const rows = every.filter((k) => {
    const at = records.position[besideRecords.place[k]];
    return at + step > span[0] && at < span[1];
  });
  const many = rows.length > 2400; // four to a point
  if (many && !besideWhole) besideWhole = besideGroups(every);
  const { gap, centre, ours, theirs, kinds: of } = many ? besideWhole : besideGroups(rows);
  data.stresses.forEach((name, c) => {
    const [one, other] = [ours, theirs].map((all) => [0, 1, 2].map((kind) => all.map((values) => values[kind][c])));
    const kinds = of.map((all) => all.map((one) => one[c]));
    const { bottom, top } = rangeOf(finite([...one.flat(), ...other.flat()]));
    const margin = 0.06 * (top - bottom || 1);
    const height = Math.max(170, Math.min(230, 0.5 * width));
    const apart = rows.filter((k) => (besideRecords.apart[k] >> c) & 1).length;
    const svg = picture(width, height, `${name} of two fits over time, ${unit}`, `Intervals that do not overlap: ${apart} of ${rows.length} records.`);
    const box = { left: 46, right: width - 18, top: 24, bottom: height - 24 };
    const { x: xOf, y, inside } = axes(svg, box, span, [bottom === 0 ? 0 : bottom - margin, top === 0 ? 0 : top + margin], {
      xTicks: timeTicks(...span, width / 75), yTicks: ticks(bottom, top, 5), yName: name,
    });
    svg.append(text(box.left + 28, box.top - 8, unit), text(box.right, box.top - 8, apart ? `${apart} do not overlap` : "", { "text-anchor": "end", class: "remark" }));
    const x = centre.map(xOf);
    const bar = Math.max(1, (xOf(step) - xOf(0)) * 0.35);
    [["", one, kinds[0]], [" other", other, kinds[1]]].forEach(([which, [median, low, high], priors]) => {
      bandsOf(centre, x, y, gap, bar, low, high, priors).forEach((d, kind) => { if (d) inside.append(path(d, kindOf(`band${which}`, kind))); });
      linesOf(centre, x, y, gap, median, priors).forEach((d, kind) => { if (d) inside.append(path(d, kindOf(`middle${which}`, kind))); });
    });
    if (bottom < 0 && top > 0) inside.append(path(`M${box.left} ${y(0)}H${box.right}`, "zero"));
    const marks = rows.filter((k) => (besideRecords.apart[k] >> c) & 1).map((k) => `M${xOf(records.position[besideRecords.place[k]] + step / 2)} ${box.bottom}v-9`).join("");
    if (marks) inside.append(path(marks, "apart"));
    const mark = path("M0 0", "chosen", { "data-mark": "time" });
    mark.place = () => mark.setAttribute("d", `M${xOf(records.position[chosen] + step / 2)} ${box.top}V${box.bottom}`);
    mark.place();
    inside.append(mark);
    alongTime(svg, box, width);
    holder.append(svg);
  });
};
