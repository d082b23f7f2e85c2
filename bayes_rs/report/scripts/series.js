// Turbulence intensity and stresses over time: blue where the data decided, hatched grey where the prior did.

/** Whether two points of a fleet's axis are of two turbines, whose records do not follow each other in time. */
const ofTwo = (one, other) => records.turbine !== null && !data.timed && turbineOf(recordAt(one)) !== turbineOf(recordAt(other));
/** Points in a row, without a gap between them. */
const runs = (centre, values, gap) => {
  const found = [];
  centre.forEach((at, k) => {
    if (values.some((one) => one[k] === null)) return;
    const last = found[found.length - 1];
    if (last && last[last.length - 1] === k - 1 && at - centre[k - 1] <= gap && !ofTwo(centre[k - 1], at)) last.push(k); else found.push([k]);
  });
  return found;
};
/** The parts of a run of one kind each; at a change of kind they meet half way. */
const partsOf = (run, kinds) => {
  const found = [];
  run.forEach((k, place) => {
    const last = found[found.length - 1];
    if (last && last.kind === kinds[k]) last.to = place; else found.push({ kind: kinds[k], from: place, to: place });
  });
  return found;
};
/** Places of a part, with the half ways to what stands beside it in its run. */
const placesOf = (run, { from, to }, x, values, y) => {
  const at = (place) => [x[run[place]], y(values[run[place]])];
  const between = (one, other) => [round((one[0] + other[0]) / 2), round((one[1] + other[1]) / 2)];
  const found = [];
  if (from > 0) found.push(between(at(from - 1), at(from)));
  for (let place = from; place <= to; place += 1) found.push(at(place));
  if (to < run.length - 1) found.push(between(at(to), at(to + 1)));
  return found;
};
/** Bands and lines over time, each part with the class of its kind. */
const bandsOf = (centre, x, y, gap, bar, lower, upper, kinds) => {
  const found = ["", ""];
  for (const run of runs(centre, [lower, upper], gap)) {
    for (const part of partsOf(run, kinds)) {
      const [low, high] = [lower, upper].map((values) => placesOf(run, part, x, values, y));
      found[part.kind] += low.length === 1
        ? `M${round(low[0][0] - bar)} ${low[0][1]}h${round(2 * bar)}V${high[0][1]}h${round(-2 * bar)}Z`
        : `M${high.map((at) => at.join(" ")).join("L")}L${low.reverse().map((at) => at.join(" ")).join("L")}Z`;
    }
  }
  return found;
};
const linesOf = (centre, x, y, gap, values, kinds) => {
  const found = ["", ""];
  for (const run of runs(centre, [values], gap)) {
    for (const part of partsOf(run, kinds)) {
      const at = placesOf(run, part, x, values, y);
      found[part.kind] += at.length === 1 ? `M${round(at[0][0] - 2)} ${at[0][1]}h4` : `M${at.map((one) => one.join(" ")).join("L")}`;
    }
  }
  return found;
};
/** Ends of the axis: a few records far off must not flatten all others. */
const rangeOf = (ends) => {
  const sorted = ends.sort((a, b) => a - b);
  if (!sorted.length) return { bottom: 0, top: 1, beyond: 0, sorted: [0] };
  let [bottom, top] = [Math.min(sorted[0], 0), Math.max(sorted[sorted.length - 1], 0)];
  const [inner, outer] = [quantile(sorted, 0.01), quantile(sorted, 0.99)];
  const range = outer - inner || top - bottom || 1;
  if (sorted.length > 100 && top > outer + 1.5 * range) top = outer + 0.25 * range;
  if (sorted.length > 100 && bottom < inner - 1.5 * range) bottom = inner - 0.25 * range;
  return { bottom, top, beyond: sorted.filter((end) => end > top || end < bottom).length, sorted };
};
const titleOf = (name) => (name === "ti" ? "TI" : name);
const unitOf = (name) => (name === "ti" ? "σ_u/U" : unit);
const priorsWords = (priors, median) => {
  const known = median.filter((value) => value !== null).length;
  const some = priors.filter((one, k) => one && median[k] !== null).length;
  if (!some) return "";
  return some === known ? "mostly the prior's" : `mostly the prior's in ${Math.max(1, Math.round(100 * some / known))} %`;
};
const stresses = (holder, full) => {
  const width = panelWidth(holder, full);
  const points = pointsShown();
  const half = points.width / 2;
  const centre = points.start.map((at) => at + half);
  const gap = 1.5 * points.width;
  const there = centre.map((at) => at + half > span[0] && at - half < span[1]);
  const shownOnly = (values) => finite(values.filter((_, k) => there[k]));
  const none = centre.map(() => 0);
  panels.forEach((name) => {
    const { median, low, high, priors, spread_low: outerLow, spread_high: outerHigh } = points.of[name];
    const reference = name === "ti" ? points.reference : null;
    const { bottom, top, beyond, sorted } = rangeOf(finite([low, high, ...(points.binned ? [outerLow, outerHigh] : []), ...(reference ? [reference] : [])].map((one) => one.filter((_, k) => there[k])).flat()));
    const margin = 0.06 * (top - bottom || 1);
    const middle = shownOnly(median).sort((a, b) => a - b);
    const height = Math.max(170, Math.min(230, 0.5 * width));
    const said = priorsWords(priors.filter((_, k) => there[k]), median.filter((_, k) => there[k]));
    const svg = picture(width, height + (beyond ? 14 : 0), `${titleOf(name)} over time, ${unitOf(name)}`, middle.length
      ? `Posterior median from ${written(middle[0])} to ${written(middle[middle.length - 1])}, half of the points below ` +
        `${written(quantile(middle, 0.5))}; ${percent} intervals (${data.interval}) from ${written(sorted[0])} to ${written(sorted[sorted.length - 1])}${said ? `; ${said}` : ""}.`
      : "No record was fitted here.");
    svg.dataset.panel = name;
    const box = { left: 46, right: width - 18, top: 24, bottom: height - 24 };
    const { x: xOf, y, inside } = axes(svg, box, span, [bottom === 0 ? 0 : bottom - margin, top === 0 ? 0 : top + margin], {
      xTicks: timeTicks(...span, width / 75), yTicks: ticks(bottom, top, 5), yName: titleOf(name),
    });
    const note = text(box.left + (name === "ti" ? 20 : 28), box.top - 8, unitOf(name));
    const remark = text(box.right, box.top - 8, said, { "text-anchor": "end", class: "remark" });
    svg.append(note, remark);
    const x = centre.map((at) => xOf(at));
    const bar = Math.max(1, (xOf(points.width) - xOf(0)) * 0.35);
    const add = ([ofData, ofPrior], kind) => {
      if (ofPrior) inside.append(path(ofPrior, `${kind} priors`));
      if (ofData) inside.append(path(ofData, kind));
    };
    if (points.room && name !== "ti") {
      const [from, to] = points.room.map((ends) => ends[columnOf(name)]);
      add(bandsOf(centre, x, y, gap, bar, from, to, none), "room");
    }
    if (points.binned) add(bandsOf(centre, x, y, gap, bar, outerLow, outerHigh, priors), "outer");
    add(bandsOf(centre, x, y, gap, bar, low, high, priors), "band");
    if (bottom < 0 && top > 0) inside.append(path(`M${box.left} ${y(0)}H${box.right}`, "zero"));
    add(linesOf(centre, x, y, gap, median, priors), centre.length > 300 ? "middle thin" : "middle");
    if (reference) add(linesOf(centre, x, y, gap, reference, none), "reference");
    let failed = "";
    let remarked = "";
    x.forEach((at, k) => {
      if (points.failed[k]) failed += `M${round(at - 4)} ${box.top}h8l-4 7Z`;
      else if (points.remarked[k]) remarked += `M${at} ${box.bottom}v-7`;
    });
    if (failed) inside.append(path(failed, "failed"));
    if (remarked) inside.append(path(remarked, "remarked"));
    const mark = path("M0 0", "chosen", { "data-mark": "time" });
    mark.place = () => mark.setAttribute("d", `M${xOf(records.position[chosen] + (points.binned ? 0 : half))} ${box.top}V${box.bottom}`);
    mark.place();
    const hair = path("M0 0", "hair");
    inside.append(mark, hair);
    if (beyond) svg.append(text(box.left, height + 8, `${beyond} ends of intervals are outside the picture, from ${written(sorted[0])} to ${written(sorted[sorted.length - 1])}`));
    const readout = text(box.right, box.top - 8, "", { "text-anchor": "end", class: "readout" });
    svg.append(readout);
    svg.hover = (place, at) => {
      remark.textContent = place === null ? said : "";
      hair.setAttribute("d", place === null ? "M0 0" : `M${xOf(at)} ${box.top}V${box.bottom}`);
      if (place === null) { readout.textContent = ""; return; }
      const values = withInterval(...inPanel(name, place, numbersOf(place)), isPriors(place, columnOf(name)));
      readout.textContent = `${nameOf(place).replace(/\d{4}-(?=\d\d-)| UTC$/g, "")}: ${values === "–" ? "not fitted" : values}`;
    };
    alongTime(svg, box, width);
    holder.append(svg);
  });
};
const recordAt = (at) => nearest(at - step / 2);
const hoverStresses = (at) => document.querySelectorAll("[data-figure=stresses] svg").forEach((svg) => {
  if (svg.hover) svg.hover(at === null ? null : recordAt(at), at);
});
