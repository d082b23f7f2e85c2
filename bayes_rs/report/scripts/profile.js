// The profile: turbulence intensity and stresses over the ranges, of all records together or of one.

const profiles = data.profile.records;
const packedProfiles = profiles ? { rows: rowsOf(profiles.rows), priors: new Uint8Array(bytes(profiles.priors)), time: stepsOf(profiles.time), number: stepsOf(profiles.number) } : null;
const nRange = data.profile.place.length;
const names = data.profile.quantities;
const nProfile = packedProfiles ? packedProfiles.number.length : 0;
let shownProfile = -1; // all records together
const profileName = (place) => {
  if (place < 0) return `all records (${data.profile.of})`;
  const start = packedProfiles.time[place];
  return Number.isFinite(start) ? `${stamp(start)} UTC` : `record ${packedProfiles.number[place]}`;
};
/** The numbers of each quantity over the ranges: median or mean, ends of the interval, and whose they are. */
const profileOf = (place) => names.map((_, q) => {
  if (place < 0) return data.profile.all[q];
  const own = { estimate: [], low: [], high: [], priors: [] };
  for (let r = 0; r < nRange; r += 1) {
    const size = packedProfiles.rows.values.length / packedProfiles.rows.unit.length;
    const offset = 3 * (nRange * q + r);
    const [estimate, low, high] = [0, 1, 2].map((k) => {
      const value = packedProfiles.rows.values[place * size + offset + k];
      return value === -32768 ? null : value * packedProfiles.rows.unit[place];
    });
    own.estimate.push(estimate);
    own.low.push(low);
    own.high.push(high);
    own.priors.push((packedProfiles.priors[place * nRange + r] >> q) & 1);
  }
  return own;
});
const profile = (holder, full) => {
  const upright = data.profile.upright;
  const width = panelWidth(holder, full);
  const height = upright ? 330 : 210;
  const all = profileOf(shownProfile);
  const places = data.profile.place;
  const reach = extent(places);
  const pad = 0.06 * (reach[1] - reach[0]) || 5;
  const what = upright ? "height above the lidar, m" : "range, m";
  names.forEach((name, q) => {
    const { estimate, low, high, priors } = all[q];
    const known = places.map((_, r) => estimate[r] !== null);
    const ends = finite([...low, ...high]);
    let [bottom, top] = ends.length ? extent([0, ...ends]) : [0, 1];
    const margin = 0.05 * (top - bottom || 1);
    if (bottom < 0) bottom -= margin;
    if (top > 0) top += margin;
    const title = name === "ti" ? "TI" : name;
    const svg = picture(width, height, `${title} over the ${upright ? "heights" : "ranges"}, ${profileName(shownProfile)}`,
      places.map((place, r) => `${written(place)} m: ${withInterval(estimate[r], low[r], high[r], priors[r])}`).join("; "));
    const box = { left: 46, right: width - 18, top: 24, bottom: height - 44 };
    const along = [reach[0] - pad, reach[1] + pad];
    const [xRange, yRange] = upright ? [[bottom, top], along] : [along, [bottom, top]];
    const value = name === "ti" ? "σ_u/U" : unit;
    const { x, y, inside } = axes(svg, box, xRange, yRange, {
      xTicks: ticks(...xRange, width / 60), yTicks: ticks(...yRange, 5), xName: upright ? value : what, yName: title,
    });
    svg.append(text(box.left + 28, box.top - 8, upright ? what : value));
    const point = (r, which) => (upright ? [x(which[r]), y(places[r])] : [x(places[r]), y(which[r])]);
    if (bottom < 0) inside.append(path(upright ? `M${x(0)} ${box.top}V${box.bottom}` : `M${box.left} ${y(0)}H${box.right}`, "zero"));
    let line = "";
    known.forEach((there, r) => { if (there) line += `${r > 0 && known[r - 1] ? "L" : "M"}${point(r, estimate).join(" ")}`; });
    if (line) inside.append(path(line, "middle thin"));
    [0, 1].forEach((kind) => {
      const some = places.map((_, r) => r).filter((r) => known[r] && priors[r] === kind);
      if (!some.length) return;
      inside.append(path(some.map((r) => `M${point(r, low).join(" ")}L${point(r, high).join(" ")}`).join(""), kindOf("whisker strong", kind)),
        path(circles(some.map((r) => point(r, estimate)), 3.5), kindOf("point", kind)));
    });
    holder.append(svg);
  });
};
