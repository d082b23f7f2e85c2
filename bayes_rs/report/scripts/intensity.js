// Turbulence intensity against wind speed.

const intensity = (holder, width) => {
  const { bin, count, priors, median, low, high, spread_low: outerLow, spread_high: outerHigh, points } = data.intensity;
  const tops = finite(points ? points.high : [...outerHigh, ...high]).sort((a, b) => a - b);
  const most = tops[tops.length - 1];
  const top = tops.length > 100 ? Math.min(most, 1.6 * quantile(tops, 0.98)) : most;
  const beyond = tops.filter((value) => value > top).length;
  const height = Math.max(240, Math.min(380, 0.55 * width));
  const svg = picture(width, height + (beyond ? 14 : 0), "Turbulence intensity against wind speed",
    `Wind speeds from ${bin[0]} to ${bin[bin.length - 1] + 1} m/s; medians over 1 m/s from ${written(Math.min(...finite(median)))} to ${written(Math.max(...finite(median)))}.`);
  const box = { left: 46, right: width - 12, top: 24, bottom: height - 44 };
  const range = points ? extent(points.speed) : [bin[0], bin[bin.length - 1] + 1];
  const pad = 0.04 * (range[1] - range[0]) || 0.5;
  const { x, y, inside } = axes(svg, box, [range[0] - pad, range[1] + pad], [0, 1.05 * top], {
    xTicks: ticks(range[0] - pad, range[1] + pad, width / 60), yTicks: ticks(0, 1.05 * top, 6), xName: "mean wind speed, m/s", yName: "σ_u/U",
  });
  const steps = (lower, upper, kind) => [0, 1].forEach((one) => {
    const d = bin.map((start, k) => (priors[k] === one ? `M${x(start)} ${y(lower[k])}H${x(start + 1)}V${y(upper[k])}H${x(start)}Z` : "")).join("");
    if (d) inside.append(path(d, kindOf(kind, one)));
  });
  if (points) {
    const flagged = points.record.map((_, k) => points.flagged[k] === 1);
    const at = points.record.map((_, k) => [x(points.speed[k]), y(points.median[k])]);
    [0, 1].forEach((kind) => {
      const some = (k) => points.priors[k] === kind;
      const lines = at.map(([px], k) => (some(k) ? `M${px} ${y(points.low[k])}V${y(points.high[k])}` : "")).join("");
      const plain = at.filter((_, k) => some(k) && !flagged[k]);
      if (lines) inside.append(path(lines, kindOf("whisker", kind)));
      if (plain.length) inside.append(kind ? path(circles(plain, 2.5), "dot priors") : path(dots(plain), "dot"));
    });
    if (flagged.includes(true)) inside.append(path(circles(at.filter((_, k) => flagged[k]), 3), "hollow"));
    const mark = path("M0 0", "chosen");
    mark.setAttribute("data-mark", "point");
    mark.place = () => {
      const k = points.record.indexOf(chosen);
      mark.setAttribute("d", k < 0 ? "M0 0" : circles([at[k]], 7));
    };
    mark.place();
    inside.append(mark);
  } else {
    steps(outerLow, outerHigh, "outer");
    steps(low, high, "band");
  }
  [0, 1].forEach((one) => {
    const d = bin.map((start, k) => (priors[k] !== one || (points && count[k] < 3) ? "" : `M${x(start)} ${y(median[k])}H${x(start + 1)}`)).join("");
    if (d) inside.append(path(d, kindOf("middle", one)));
  });
  if (beyond) svg.append(text(box.left, height + 8, `${beyond} ends of intervals are above the picture, up to ${written(most)}`));
  holder.append(svg);
};
