"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const SVG = "http://www.w3.org/2000/svg";
  const DAY = 864e5;
  const percent = `${+(100 * data.prob).toPrecision(4)} %`;
  const unit = "m² s⁻²";

  // ---- numbers

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const rowsOf = (packed) => ({ values: new Int16Array(bytes(packed.values)), unit: new Float32Array(bytes(packed.unit)) });
  const stepsOf = ({ values, first, step, n: count }) =>
    values ? new Float64Array(bytes(values)) : Float64Array.from({ length: count }, (_, k) => first + k * step);
  const finite = (values) => values.filter((value) => value !== null && Number.isFinite(value));
  const written = (value, digits = 3) => {
    if (value === null || !Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(digits - 1).replace(/-/g, "−");
    const places = size === 0 ? digits - 1 : Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
    return value.toFixed(places).replace(/-/g, "−");
  };
  const fixed = (value) => (Number.isFinite(value) ? value.toFixed(2).replace(/^-(?=0\.00)/, "").replace("-", "−") : "–");
  const stamp = (ms) => new Date(ms).toISOString().slice(0, 19).replace("T", " ").replace(/:00$/, "");
  const quantile = (sorted, q) => {
    const place = q * (sorted.length - 1);
    const below = Math.floor(place);
    const above = Math.min(below + 1, sorted.length - 1);
    return sorted[below] + (place - below) * (sorted[above] - sorted[below]);
  };
  const extent = (values) => values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);

  const niceStep = (span, most) => {
    const rough = span / most;
    const power = 10 ** Math.floor(Math.log10(rough));
    return power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
  };
  const ticks = (low, high, most) => {
    const step = niceStep(high - low || 1, most);
    const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
      found.push([k * step, (k * step).toFixed(places).replace(/^-(?=0\.?0*$)/, "").replace("-", "−")]);
    }
    return found;
  };
  const timeTicks = (low, high, most) => {
    if (!data.timed) return ticks(low, high, most).filter(([value]) => Number.isInteger(value));
    const steps = [1 / 1440, 1 / 288, 1 / 144, 1 / 48, 1 / 24, 1 / 12, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 7, 14].map((days) => days * DAY);
    const step = steps.find((one) => (high - low) / one <= most);
    const found = [];
    if (step === undefined) {
      const months = [1, 2, 3, 6, 12, 24, 60, 120].find((one) => (high - low) / (one * 30 * DAY) <= most) || 240;
      const first = new Date(low);
      for (let year = first.getUTCFullYear(), month = 0; ; month += months) {
        const at = Date.UTC(year, month, 1);
        if (at > high) break;
        if (at >= low) found.push([at, new Date(at).toISOString().slice(0, 7)]);
      }
      return found;
    }
    for (let at = Math.ceil(low / step) * step; at <= high; at += step) {
      const text = new Date(at).toISOString();
      found.push([at, step >= DAY || at % DAY === 0 ? text.slice(5, 10) : text.slice(11, 16)]);
    }
    return found;
  };

  // ---- drawing

  let serial = 0;
  const element = (name, attributes = {}, ...children) => {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  };
  const text = (x, y, words, attributes = {}) => element("text", { x: round(x), y: round(y), ...attributes }, words);
  const round = (value) => Math.round(value * 100) / 100;
  const path = (d, kind, attributes = {}) => element("path", { d, class: kind, ...attributes });
  const picture = (width, height, name, description) => {
    serial += 1;
    const title = element("title", { id: `title-${serial}` }, name);
    const more = element("desc", { id: `desc-${serial}` }, description);
    const svg = element("svg", {
      viewBox: `0 0 ${round(width)} ${round(height)}`,
      role: "img",
      "aria-labelledby": title.id,
      "aria-describedby": more.id,
    }, title, more);
    if (width < 420) svg.setAttribute("class", "small");
    return svg;
  };
  const scale = ([low, high], [from, to]) => {
    const factor = (to - from) / (high - low || 1);
    return (value) => round(from + (value - low) * factor);
  };
  const clipped = (svg, x, y, width, height) => {
    serial += 1;
    const clip = element("clipPath", { id: `clip-${serial}` }, element("rect", { x, y, width, height }));
    const inside = element("g", { "clip-path": `url(#clip-${serial})` });
    svg.append(clip, inside);
    return inside;
  };
  /** Axes with ticks; returns the scales and a group that is clipped to them. */
  const axes = (svg, box, xRange, yRange, { xTicks, yTicks, xName = "", yName = "" }) => {
    const x = scale(xRange, [box.left, box.right]);
    const y = scale(yRange, [box.bottom, box.top]);
    let grid = "";
    for (const [value, words] of xTicks) {
      grid += `M${x(value)} ${box.top}V${box.bottom}`;
      svg.append(text(x(value), box.bottom + 15, words, { "text-anchor": "middle" }));
    }
    for (const [value, words] of yTicks) {
      grid += `M${box.left} ${y(value)}H${box.right}`;
      svg.append(text(box.left - 5, y(value) + 4, words, { "text-anchor": "end" }));
    }
    svg.append(path(grid || "M0 0", "grid"));
    if (xName) svg.append(text((box.left + box.right) / 2, box.bottom + 32, xName, { "text-anchor": "middle" }));
    if (yName) svg.append(text(box.left, box.top - 8, yName, { class: "strong" }));
    const inside = clipped(svg, box.left, box.top, box.right - box.left, box.bottom - box.top);
    svg.append(path(`M${box.left} ${box.top}H${box.right}V${box.bottom}H${box.left}Z`, "frame"));
    return { x, y, inside };
  };
  const dots = (points) => points.map(([x, y]) => `M${x} ${y}h0`).join("");
  const circles = (points, radius) => points.map(([x, y]) => `M${round(x - radius)} ${y}a${radius} ${radius} 0 1 0 ${2 * radius} 0a${radius} ${radius} 0 1 0 ${-2 * radius} 0`).join("");

  // ---- records

  const packed = data.records;
  const records = {
    number: stepsOf(packed.record),
    position: stepsOf(packed.position),
    flag: Array.from(new Uint16Array(bytes(packed.flag.place)), (place) => packed.flag.values[place]),
    speed: new Float32Array(bytes(packed.speed)),
    numbers: rowsOf(packed.numbers),
    correlation: new Int8Array(bytes(packed.correlation)),
    decided: packed.decided ? new Int8Array(bytes(packed.decided)) : null,
    beside: packed.beside ? rowsOf(packed.beside) : null,
  };
  const n = records.number.length;
  const pairs = [];
  for (let i = 0; i < 6; i += 1) for (let j = i + 1; j < 6; j += 1) pairs.push([i, j]);
  const unpacked = (rows, row, count, offset = 0) => {
    const out = new Array(count);
    const size = rows.values.length / rows.unit.length;
    for (let k = 0; k < count; k += 1) {
      const value = rows.values[row * size + offset + k];
      out[k] = value === -32768 ? NaN : value * rows.unit[row];
    }
    return out;
  };
  const numbersOf = (place) => {
    const [median, low, high, mean, sd] = [0, 6, 12, 18, 24].map((offset) => unpacked(records.numbers, place, 6, offset));
    return { median, low, high, mean, sd };
  };
  const nameOf = (place) => data.timed ? `${stamp(records.position[place])} UTC` : `record ${records.number[place]}`;
  const flagsOf = (place) => Object.entries(data.flags).filter(([, bit]) => records.flag[place] & bit).map(([word]) => word);
  const draws = packed.draws ? { n: packed.draws.n, ...rowsOf(packed.draws) } : null;
  const prior = packed.prior ? { n: packed.prior.n, ...rowsOf(packed.prior) } : null;
  const columnsOf = (flat, count) => data.stresses.map((_, column) => Array.from({ length: count }, (_unused, row) => flat[6 * row + column]));
  const drawsOf = (place) => {
    if (!draws) return null;
    const flat = unpacked(draws, place, 6 * draws.n).filter(Number.isFinite);
    return flat.length ? columnsOf(flat, flat.length / 6) : null;
  };
  /** Prior shapes at the sizes of the posterior's draws, or at that of its mean where there are no draws. */
  const priorOf = (columns, mean) => {
    if (!prior) return null;
    const size = columns ? columns[0].map((_, row) => columns[0][row] + columns[1][row] + columns[2][row]) : [mean[0] + mean[1] + mean[2]];
    return data.stresses.map((_, column) => Array.from({ length: prior.n }, (_unused, row) =>
      prior.values[6 * row + column] * prior.unit[row] * size[row % size.length]));
  };
  let chosen = packed.first;

  // ---- availability

  const level = (share) => share <= 0 ? 0 : share < 0.5 ? 1 : share < 0.8 ? 2 : share < 0.95 ? 3 : 4;
  const availability = (holder, width) => {
    const { beam, edges, share, usable } = data.availability;
    const cell = Math.max(5, Math.min(22, 240 / beam.length));
    const box = { left: 46, right: width - 12, top: 74, bottom: 74 + cell * beam.length };
    const what = data.availability.of_samples ? "samples used" : "usable beams";
    const all = finite(share.flat());
    const mean = all.reduce((sum, value) => sum + value, 0) / all.length;
    const svg = picture(width, box.bottom + 40, `Availability: share of ${what}, beam by time`,
      `${beam.length} rows, ${edges.length - 1} columns; mean share ${written(100 * mean)} %.`);
    const range = [edges[0], edges[edges.length - 1]];
    const above = { ...box, top: 18, bottom: 60 };
    const strip = axes(svg, above, range, [0, 1], { xTicks: [], yTicks: [[0, "0"], [1, "1"]], yName: "share of usable beams" });
    let outline = `M${strip.x(edges[0])} ${strip.y(0)}`;
    usable.forEach((value, k) => { outline += `V${strip.y(value)}H${strip.x(edges[k + 1])}`; });
    strip.inside.append(path(`${outline}V${strip.y(0)}Z`, "band"));
    const every = Math.ceil(13 / cell);
    const { x, inside } = axes(svg, box, range, [0, 1], {
      xTicks: timeTicks(...range, width / 85), yTicks: [], xName: data.timed ? "time (UTC)" : "record",
    });
    const cells = ["", "", "", "", ""];
    share.forEach((row, r) => {
      const top = round(box.top + r * cell);
      for (let k = 0; k < row.length;) {
        let end = k + 1;
        const one = level(row[k]);
        while (end < row.length && level(row[end]) === one) end += 1;
        cells[one] += `M${x(edges[k])} ${top}H${x(edges[end])}V${round(top + cell - (cell > 8 ? 1 : 0))}H${x(edges[k])}Z`;
        k = end;
      }
      if (r % every === 0) svg.append(text(box.left - 5, top + cell / 2 + 4, beam[r], { "text-anchor": "end" }));
    });
    cells.forEach((d, k) => { if (d) inside.append(path(d, `level-${k}`)); });
    svg.append(text(12, (box.top + box.bottom) / 2, "beam", { "text-anchor": "middle", transform: `rotate(-90 12 ${(box.top + box.bottom) / 2})` }));
    holder.append(svg);
  };

  // ---- stresses over time

  const nearest = (position) => {
    let low = 0;
    let high = n - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (records.position[middle] <= position) low = middle; else high = middle;
    }
    return position - records.position[low] <= records.position[high] - position ? low : high;
  };
  const runs = (centre, values, gap) => {
    const found = [];
    centre.forEach((at, k) => {
      if (values.some((one) => one[k] === null)) return;
      const last = found[found.length - 1];
      if (last && last[last.length - 1] === k - 1 && at - centre[k - 1] <= gap) last.push(k); else found.push([k]);
    });
    return found;
  };
  const stresses = (holder, full) => {
    const series = data.series;
    const style = getComputedStyle(holder);
    const columns = style.gridTemplateColumns.split(" ").length;
    const width = Math.floor((full - (columns - 1) * parseFloat(style.columnGap || "0")) / columns);
    const half = series.width / 2;
    const centre = series.start.map((at) => at + half);
    const range = [series.start[0], series.start[series.start.length - 1] + series.width];
    data.stresses.forEach((name, c) => {
      const [median, low, high] = [series.median[c], series.low[c], series.high[c]];
      const ends = finite([...low, ...high, ...(series.binned ? [...series.spread_low[c], ...series.spread_high[c]] : [])]).sort((a, b) => a - b);
      // a few records far off must not flatten all others: they are named beneath the panel
      let [bottom, top] = [Math.min(ends[0], 0), Math.max(ends[ends.length - 1], 0)];
      const [inner, outer] = [quantile(ends, 0.01), quantile(ends, 0.99)];
      const span = outer - inner || top - bottom || 1;
      if (ends.length > 100 && top > outer + 1.5 * span) top = outer + 0.25 * span;
      if (ends.length > 100 && bottom < inner - 1.5 * span) bottom = inner - 0.25 * span;
      const beyond = ends.filter((end) => end > top || end < bottom).length;
      const margin = 0.06 * (top - bottom || 1);
      const middle = finite(median).sort((a, b) => a - b);
      const height = Math.max(170, Math.min(230, 0.5 * width));
      const svg = picture(width, height + (beyond ? 14 : 0), `${name} over time, ${unit}`,
        `Posterior median from ${written(middle[0])} to ${written(middle[middle.length - 1])}, half of the points below ` +
        `${written(quantile(middle, 0.5))}; ${percent} intervals from ${written(ends[0])} to ${written(ends[ends.length - 1])}.`);
      const box = { left: 46, right: width - 10, top: 24, bottom: height - 24 };
      const { x, y, inside } = axes(svg, box, range, [bottom === 0 ? 0 : bottom - margin, top === 0 ? 0 : top + margin], {
        xTicks: timeTicks(...range, width / 75), yTicks: ticks(bottom, top, 5), yName: name,
      });
      svg.append(text(box.left + 30, box.top - 8, unit));
      const ribbon = (lower, upper, kind) => {
        let d = "";
        for (const run of runs(centre, [lower, upper], 1.5 * series.width)) {
          if (run.length === 1) {
            const k = run[0];
            const w = Math.max(1, (x(centre[k] + half) - x(centre[k] - half)) * 0.35);
            d += `M${round(x(centre[k]) - w)} ${y(lower[k])}h${round(2 * w)}V${y(upper[k])}h${round(-2 * w)}Z`;
          } else {
            d += `M${run.map((k) => `${x(centre[k])} ${y(upper[k])}`).join("L")}L${run.slice().reverse().map((k) => `${x(centre[k])} ${y(lower[k])}`).join("L")}Z`;
          }
        }
        if (d) inside.append(path(d, kind));
      };
      if (series.binned) ribbon(series.spread_low[c], series.spread_high[c], "outer");
      ribbon(low, high, "band");
      if (bottom < 0 && top > 0) inside.append(path(`M${box.left} ${y(0)}H${box.right}`, "zero"));
      let line = "";
      for (const run of runs(centre, [median], 1.5 * series.width)) {
        line += run.length === 1 ? `M${round(x(centre[run[0]]) - 2)} ${y(median[run[0]])}h4` : `M${run.map((k) => `${x(centre[k])} ${y(median[k])}`).join("L")}`;
      }
      if (line) inside.append(path(line, centre.length > 300 ? "middle thin" : "middle"));
      let failed = "";
      let remarked = "";
      centre.forEach((at, k) => {
        if (series.failed[k]) failed += `M${round(x(at) - 4)} ${box.top}h8l-4 7Z`;
        else if (series.remarked[k]) remarked += `M${x(at)} ${box.bottom}v-7`;
      });
      if (failed) inside.append(path(failed, "failed"));
      if (remarked) inside.append(path(remarked, "remarked"));
      const mark = path("M0 0", "chosen", { "data-mark": "time" });
      mark.place = () => mark.setAttribute("d", `M${x(records.position[chosen] + (series.binned ? 0 : half))} ${box.top}V${box.bottom}`);
      mark.place();
      inside.append(mark);
      if (beyond) svg.append(text(box.left, height + 8, `${beyond} ends of intervals are outside the picture, from ${written(ends[0])} to ${written(ends[ends.length - 1])}`));
      const readout = text(box.right, box.top - 8, "", { "text-anchor": "end", class: "readout" });
      svg.append(readout);
      const under = (event) => {
        const place = svg.getBoundingClientRect();
        const at = (event.clientX - place.left) * width / place.width;
        return range[0] + (at - box.left) / (box.right - box.left) * (range[1] - range[0]) - (series.binned ? 0 : half);
      };
      svg.addEventListener("pointermove", (event) => {
        const near = nearest(under(event));
        const { median: m, low: l, high: h } = numbersOf(near);
        const values = Number.isFinite(m[c]) ? `${written(m[c])} (${written(l[c])} to ${written(h[c])})` : "not fitted";
        readout.textContent = `${nameOf(near).replace(/^\d{4}-| UTC$/g, "")}: ${values}`;
      });
      svg.addEventListener("pointerleave", () => { readout.textContent = ""; });
      svg.classList.add("pickable");
      svg.addEventListener("click", (event) => choose(nearest(under(event))));
      holder.append(svg);
    });
  };

  // ---- what the data decided

  const decided = (holder, width) => {
    const points = data.decided;
    const low = Math.max(Math.min(0, ...finite(points.flat())), -1);
    const svg = picture(width, 220, "What the data decided of each stress",
      data.stresses.map((name, k) => `${name} ${written(points[k][1], 2)}`).join("; "));
    const box = { left: 40, right: width - 14, top: 10, bottom: 180 };
    const { x, y, inside } = axes(svg, box, [low - 0.03, 1.03], [6, 0], {
      xTicks: ticks(low, 1, width / 70), yTicks: [], xName: "0: the prior decided, 1: the data did",
    });
    inside.append(path(`M${x(0)} ${box.top}V${box.bottom}M${x(1)} ${box.top}V${box.bottom}`, "zero"));
    data.stresses.forEach((name, k) => {
      const [from, middle, to] = points[k];
      const at = y(k + 0.5);
      svg.append(text(box.left - 6, at + 4, name, { "text-anchor": "end", class: "strong" }));
      if (middle === null) return;
      inside.append(path(`M${x(Math.max(from, low))} ${at}H${x(to)}`, "size"));
      inside.append(path(circles([[x(middle), at]], 4), "size"));
    });
    holder.append(svg);
  };

  // ---- turbulence intensity

  const intensity = (holder, width) => {
    const { bin, count, median, low, high, spread_low: outerLow, spread_high: outerHigh, points } = data.intensity;
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
    const steps = (lower, upper, kind) => inside.append(path(bin.map((start, k) => `M${x(start)} ${y(lower[k])}H${x(start + 1)}V${y(upper[k])}H${x(start)}Z`).join(""), kind));
    if (points) {
      const flagged = points.record.map((_, k) => points.flagged[k] === 1);
      const at = points.record.map((_, k) => [x(points.speed[k]), y(points.median[k])]);
      inside.append(path(at.map(([px], k) => `M${px} ${y(points.low[k])}V${y(points.high[k])}`).join(""), "whisker"));
      if (flagged.includes(false)) inside.append(path(dots(at.filter((_, k) => !flagged[k])), "dot"));
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
    inside.append(path(bin.map((start, k) => (points && count[k] < 3 ? "" : `M${x(start)} ${y(median[k])}H${x(start + 1)}`)).join("") || "M0 0", "middle"));
    if (beyond) svg.append(text(box.left, height + 8, `${beyond} ends of intervals are above the picture, up to ${written(most)}`));
    holder.append(svg);
  };

  // ---- corner

  /** Smoothed histogram on a grid, and the heights of the contours that hold 68 and 95 %. */
  const density = (xs, ys, xRange, yRange, size) => {
    const spread = (values, [low, high]) => {
      const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
      const sd = Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / values.length);
      return Math.max(0.8, 0.9 * sd / (high - low) * size * values.length ** (-1 / 6));
    };
    const smooth = (grid, sigma, across) => {
      const reach = Math.ceil(3 * sigma);
      const weights = Array.from({ length: 2 * reach + 1 }, (_, k) => Math.exp(-0.5 * ((k - reach) / sigma) ** 2));
      const sum = weights.reduce((a, b) => a + b, 0);
      const out = new Float64Array(size * size);
      for (let row = 0; row < size; row += 1) {
        for (let column = 0; column < size; column += 1) {
          let total = 0;
          for (let k = -reach; k <= reach; k += 1) {
            const [r, c] = across ? [row, column + k] : [row + k, column];
            if (r >= 0 && r < size && c >= 0 && c < size) total += weights[k + reach] * grid[r * size + c];
          }
          out[row * size + column] = total / sum;
        }
      }
      return out;
    };
    let grid = new Float64Array(size * size);
    xs.forEach((value, k) => {
      const column = Math.floor((value - xRange[0]) / (xRange[1] - xRange[0]) * size);
      const row = Math.floor((ys[k] - yRange[0]) / (yRange[1] - yRange[0]) * size);
      if (column >= 0 && column < size && row >= 0 && row < size) grid[row * size + column] += 1;
    });
    grid = smooth(smooth(grid, spread(xs, xRange), true), spread(ys, yRange), false);
    const ordered = Float64Array.from(grid).sort().reverse();
    const total = ordered.reduce((a, b) => a + b, 0);
    const levels = [0.68, 0.95].map((share) => {
      let held = 0;
      for (const value of ordered) {
        held += value;
        if (held >= share * total) return value;
      }
      return 0;
    });
    return { grid, levels };
  };
  /** Lines where the grid crosses a height: marching squares, the pieces joined so that dashes can be seen. */
  const contour = (grid, size, height, x, y) => {
    const at = (row, column) => grid[row * size + column];
    const links = new Map(); // crossings by the edge of the grid that they are on
    const places = new Map();
    for (let row = 0; row < size - 1; row += 1) {
      for (let column = 0; column < size - 1; column += 1) {
        const corners = [[row, column], [row, column + 1], [row + 1, column + 1], [row + 1, column]];
        const cut = [];
        for (let k = 0; k < 4; k += 1) {
          const [one, two] = [corners[k], corners[(k + 1) % 4]];
          const [a, b] = [at(...one), at(...two)];
          if ((a >= height) !== (b >= height)) {
            const share = (height - a) / (b - a);
            const edge = (one[0] + two[0]) * 4 * size + one[1] + two[1];
            places.set(edge, `${x(one[1] + share * (two[1] - one[1]) + 0.5)} ${y(one[0] + share * (two[0] - one[0]) + 0.5)}`);
            cut.push(edge);
          }
        }
        for (let k = 0; k + 1 < cut.length; k += 2) {
          for (const [one, two] of [[cut[k], cut[k + 1]], [cut[k + 1], cut[k]]]) links.set(one, [...(links.get(one) || []), two]);
        }
      }
    }
    const ordered = [...links.keys()].sort((one, two) => links.get(one).length - links.get(two).length); // ends of lines first
    const seen = new Set();
    let d = "";
    for (const start of ordered) {
      if (seen.has(start)) continue;
      let line = "";
      for (let edge = start; edge !== undefined; edge = links.get(edge).find((next) => !seen.has(next))) {
        seen.add(edge);
        line += `${line ? "L" : "M"}${places.get(edge)}`;
        if (!links.get(edge).some((next) => !seen.has(next)) && line.includes("L") && links.get(edge).includes(start)) line += "Z";
      }
      if (line.includes("L")) d += line;
    }
    return d;
  };
  const histogram = (values, [low, high], count) => {
    const bins = new Array(count).fill(0);
    values.forEach((value) => {
      const k = Math.floor((value - low) / (high - low) * count);
      if (k >= 0 && k < count) bins[k] += 1;
    });
    return bins.map((one) => one / (values.length * (high - low) / count));
  };
  const outline = (heights, [low, high], x, y) => {
    const step = (high - low) / heights.length;
    return `M${x(low)} ${y(0)}${heights.map((value, k) => `V${y(value)}H${x(low + (k + 1) * step)}`).join("")}V${y(0)}`;
  };
  const ellipse = (mean, sd, correlation, share, x, y) => {
    const radius = Math.sqrt(-2 * Math.log(1 - share));
    const points = [];
    for (let k = 0; k <= 60; k += 1) {
      const angle = 2 * Math.PI * k / 60;
      const [a, b] = [Math.cos(angle), Math.sin(angle)];
      points.push(`${x(mean[0] + radius * sd[0] * a)} ${y(mean[1] + radius * sd[1] * (correlation * a + Math.sqrt(Math.max(0, 1 - correlation ** 2)) * b))}`);
    }
    return `M${points.join("L")}Z`;
  };
  const correlationOf = (i, j) => {
    const place = pairs.findIndex(([one, other]) => one === Math.min(i, j) && other === Math.max(i, j));
    const value = records.correlation[chosen * pairs.length + place];
    return value === -128 ? NaN : value / 100;
  };
  const corner = (holder, full) => {
    const width = Math.min(full, 864);
    const numbers = numbersOf(chosen);
    if (!numbers.mean.every(Number.isFinite)) {
      const words = document.createElement("p");
      words.className = "note";
      words.textContent = `This record was not fitted: ${flagsOf(chosen).join(", ")}.`;
      holder.append(words);
      return;
    }
    const small = width < 520;
    const posterior = drawsOf(chosen);
    const shapes = priorOf(posterior, numbers.mean);
    const ranges = data.stresses.map((_, c) => {
      const gaussian = [numbers.mean[c] - 3.2 * numbers.sd[c], numbers.mean[c] + 3.2 * numbers.sd[c]];
      let range = gaussian;
      if (posterior || shapes) {
        const ends = [posterior, shapes].filter(Boolean).map((columns) => {
          const sorted = columns[c].slice().sort((a, b) => a - b);
          return [quantile(sorted, 0.005), quantile(sorted, 0.995)];
        });
        range = extent([...ends.flat(), ...(posterior ? [] : gaussian)]);
        const margin = 0.08 * (range[1] - range[0]);
        range = [range[0] - (c < 3 ? 0 : margin), range[1] + margin];
      }
      if (c < 3) range[0] = Math.min(range[0], 0);
      return range[1] > range[0] ? range : [range[0] - 0.5, range[1] + 0.5];
    });
    const [left, foot, gap] = [small ? 30 : 50, small ? 46 : 54, small ? 3 : 6];
    const cell = (width - left - 8 - 5 * gap) / 6;
    const svg = picture(width, 20 + 6 * cell + 5 * gap + foot, `Corner plot of ${nameOf(chosen)}`,
      data.stresses.map((name, c) => `${name} ${written(numbers.median[c])}, ${percent} from ${written(numbers.low[c])} to ${written(numbers.high[c])}`).join("; "));
    if (small) svg.setAttribute("class", "small");
    const near = (c, most) => {
      const [low, high] = ranges[c];
      const inset = (small ? 0.16 : 0.08) * (high - low); // labels of neighbours must not touch
      return ticks(low + inset, high - inset, most);
    };
    for (let row = 0; row < 6; row += 1) {
      for (let column = 0; column <= row; column += 1) {
        const box = { left: round(left + column * (cell + gap)), top: round(20 + row * (cell + gap)) };
        box.right = round(box.left + cell);
        box.bottom = round(box.top + cell);
        const x = scale(ranges[column], [box.left, box.right]);
        const inside = clipped(svg, box.left, box.top, round(cell), round(cell));
        if (row === column) {
          const c = row;
          const bins = small ? 16 : 28;
          const [low, high] = ranges[c];
          let heights;
          if (posterior) {
            heights = histogram(posterior[c], ranges[c], bins);
          } else {
            heights = Array.from({ length: 120 }, (_, k) => {
              const at = low + (k + 0.5) / 120 * (high - low);
              return Math.exp(-0.5 * ((at - numbers.mean[c]) / numbers.sd[c]) ** 2) / (numbers.sd[c] * Math.sqrt(2 * Math.PI));
            });
          }
          const before = shapes && histogram(shapes[c], ranges[c], bins);
          const y = scale([0, 1.25 * Math.max(...heights, ...(before || [0]))], [box.bottom, box.top]);
          inside.append(path(`M${x(numbers.low[c])} ${box.top}H${x(numbers.high[c])}V${box.bottom}H${x(numbers.low[c])}Z`, "outer"));
          inside.append(path(`${outline(heights, ranges[c], x, y)}Z`, "band"));
          inside.append(path(outline(heights, ranges[c], x, y), "middle"));
          if (before) inside.append(path(outline(before, ranges[c], x, y), "prior"));
          inside.append(path(`M${x(numbers.median[c])} ${box.top}V${box.bottom}`, "zero"));
          svg.append(text(box.left + cell / 2, box.top - 5, small ? data.stresses[c] : `${data.stresses[c]} ${written(numbers.median[c], 2)}`, { "text-anchor": "middle", class: "strong" }));
        } else {
          const y = scale(ranges[row], [box.bottom, box.top]);
          const size = small ? 24 : 36;
          const inCell = [scale([0, size], [box.left, box.right]), scale([0, size], [box.bottom, box.top])];
          const contours = (columns, kind) => {
            if (!columns) return;
            const { grid, levels } = density(columns[column], columns[row], ranges[column], ranges[row], size);
            const d = levels.map((height) => contour(grid, size, height, ...inCell)).join("");
            if (d) inside.append(path(d, kind));
          };
          if (posterior) {
            inside.append(path(dots(posterior[column].map((value, k) => [x(value), y(posterior[row][k])])), "dot draws"));
            contours(posterior, "middle");
          } else {
            const [mean, sd] = [[numbers.mean[column], numbers.mean[row]], [numbers.sd[column], numbers.sd[row]]];
            inside.append(path(ellipse(mean, sd, correlationOf(column, row), 0.95, x, y), "outer"));
            inside.append(path(ellipse(mean, sd, correlationOf(column, row), 0.68, x, y), "band"));
            inside.append(path(dots([[x(mean[0]), y(mean[1])]]), "dot"));
          }
          contours(shapes, "prior");
          if (column === 0) {
            for (const [value, words] of near(row, small ? 2 : 4)) svg.append(text(box.left - 3, y(value) + 4, words, { "text-anchor": "end" }));
          }
        }
        if (row === 5) {
          for (const [value, words] of near(column, small ? 2 : 4)) svg.append(text(x(value), box.bottom + 13, words, { "text-anchor": "middle" }));
          svg.append(text(box.left + cell / 2, box.bottom + (small ? 27 : 30), data.stresses[column], { "text-anchor": "middle", class: "strong" }));
        }
        svg.append(path(`M${box.left} ${box.top}H${box.right}V${box.bottom}H${box.left}Z`, "frame"));
      }
    }
    svg.append(text(left + 3 * (cell + gap), 20 + 6 * cell + 5 * gap + foot - 4, `all axes in ${unit}`, { "text-anchor": "middle" }));
    holder.append(svg);
  };
  const key = (kind, words) => {
    const span = document.createElement("span");
    span.className = "key";
    const swatch = document.createElement("span");
    swatch.className = `swatch ${kind}`;
    swatch.setAttribute("aria-hidden", "true");
    span.append(swatch, words);
    return span;
  };
  const cornerWords = () => {
    const holder = document.getElementById("corner-words");
    if (!holder) return;
    const posterior = drawsOf(chosen);
    holder.replaceChildren();
    if (posterior) {
      holder.append(key("dot", `${posterior[0].length} draws of the posterior, contours hold 68 and 95 %`));
    } else {
      holder.append(key("band", "68 %"), key("outer", "95 % of a Gaussian with the posterior's mean and covariance: the draws are not in this page, and the posterior itself is realizable and skewed"));
    }
    if (prior) holder.append(key("prior", "prior at the posterior's size: where the posterior fills it, the data said nothing of the shape"));
    holder.append(key("outer", `in the panels on the diagonal, the ${percent} interval; dotted, the median`));
  };
  const cell = (tag, words, attributes = {}) => {
    const made = document.createElement(tag);
    made.textContent = words;
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  };
  const chosenTable = () => {
    const holder = document.getElementById("chosen-table");
    if (!holder) return;
    const numbers = numbersOf(chosen);
    const tableOf = (caption, names, rowOf) => {
      const table = document.createElement("table");
      const head = document.createElement("thead");
      const heading = document.createElement("tr");
      ["stress", ...names].forEach((words, k) => heading.append(cell("th", words, { scope: "col", ...(k ? { class: "n" } : {}) })));
      head.append(heading);
      const body = document.createElement("tbody");
      data.stresses.forEach((name, row) => {
        const line = document.createElement("tr");
        line.append(cell("th", name, { scope: "row" }), ...rowOf(row).map((words) => cell("td", words, { class: "n" })));
        body.append(line);
      });
      table.append(cell("caption", caption), head, body);
      const box = document.createElement("div");
      for (const [name, value] of [["class", "scroll"], ["tabindex", "0"], ["role", "region"], ["aria-label", caption]]) box.setAttribute(name, value);
      box.append(table);
      return box;
    };
    const tables = [tableOf(
      `Posterior of ${nameOf(chosen)}, ${unit}, and correlations between the stresses`,
      ["median", `${percent} from`, "to", "mean", "sd", ...data.stresses.slice(1).map((name) => `corr. ${name}`)],
      (row) => [
        ...[numbers.median, numbers.low, numbers.high, numbers.mean, numbers.sd].map((column) => written(column[row])),
        ...[1, 2, 3, 4, 5].map((column) => (row < column ? fixed(correlationOf(row, column)) : "")),
      ],
    )];
    if (records.decided) {
      const share = (row) => records.decided[6 * chosen + row];
      tables.push(tableOf(
        `What the data decided of ${nameOf(chosen)} (1: the data's, 0: the prior's), and least squares on the same variances, ${unit}`,
        ["decided", "least squares", "its standard error"],
        (row) => [share(row) === -128 ? "–" : fixed(share(row) / 100), ...[0, 6].map((offset) => written(unpacked(records.beside, chosen, 6, offset)[row]))],
      ));
    }
    holder.replaceChildren(...tables);
  };

  // ---- Lumley triangle

  const invariants = (stress) => {
    const [uu, vv, ww, uv, uw, vw] = stress;
    const trace = uu + vv + ww;
    const [a, b, c, d, e, f] = [uu / trace - 1 / 3, vv / trace - 1 / 3, ww / trace - 1 / 3, uv / trace, uw / trace, vw / trace];
    const second = a * a + b * b + c * c + 2 * (d * d + e * e + f * f);
    const third = 3 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)); // 3 det b: the trace of b is 0
    return [Math.cbrt(third / 6), Math.sqrt(second / 6)];
  };
  const shape = (holder, width) => {
    const { record, xi, eta } = data.shape;
    const height = 0.72 * width;
    const svg = picture(width, height, "Shape of the tensor: Lumley triangle",
      `Posterior means of ${xi.length} records; ξ from ${written(Math.min(...xi))} to ${written(Math.max(...xi))}, η from ${written(Math.min(...eta))} to ${written(Math.max(...eta))}.`);
    const box = { left: 46, right: width - 10, top: 24, bottom: height - 44 };
    const { x, y, inside } = axes(svg, box, [-0.2, 0.36], [0, 0.36], { xTicks: ticks(-0.2, 0.36, 6), yTicks: ticks(0, 0.36, 5), xName: "ξ", yName: "η" });
    let edge = `M${x(-1 / 6)} ${y(1 / 6)}L${x(0)} ${y(0)}L${x(1 / 3)} ${y(1 / 3)}`;
    for (let k = 60; k >= 0; k -= 1) {
      const at = -1 / 6 + k / 60 * 0.5;
      edge += `L${x(at)} ${y(Math.sqrt(1 / 27 + 2 * at ** 3))}`;
    }
    [[0, 0, "isotropic", "start", 8, -4], [1 / 3, 1 / 3, "one component", "end", -8, -6], [-1 / 6, 1 / 6, "two, equal", "start", -4, -8]].forEach(
      ([atXi, atEta, words, anchor, dx, dy]) => svg.append(text(x(atXi) + dx, y(atEta) + dy, words, { "text-anchor": anchor })));
    const cloud = path("M0 0", "cloud");
    const mark = path("M0 0", "chosen");
    mark.setAttribute("data-mark", "shape");
    mark.place = () => {
      const posterior = drawsOf(chosen);
      cloud.setAttribute("d", posterior ? dots(posterior[0].map((_, k) => {
        const [a, b] = invariants(posterior.map((column) => column[k]));
        return [x(a), y(b)];
      })) : "M0 0");
      const [a, b] = invariants(numbersOf(chosen).mean);
      mark.setAttribute("d", Number.isFinite(a) ? circles([[x(a), y(b)]], 7) : "M0 0");
    };
    mark.place();
    inside.append(cloud, path(`${edge}Z`, "edge"), path(dots(record.map((_, k) => [x(xi[k]), y(eta[k])])), xi.length > 400 ? "dot draws" : "dot"), mark);
    holder.append(svg);
  };

  // ---- diagnostics

  const names = { ess_bulk: "bulk ESS (least)", ess_tail: "tail ESS (least)", r_hat: "R-hat (largest)", pareto_k: "Pareto k", misfit: "misfit, sd" };
  const diagnostics = (holder, full) => {
    const style = getComputedStyle(holder);
    const columns = style.gridTemplateColumns.split(" ").length;
    const width = Math.floor((full - (columns - 1) * parseFloat(style.columnGap || "0")) / columns);
    data.diagnostics.forEach(({ name, count, edges, limit }) => {
      const range = extent(limit === null ? [edges[0], edges[edges.length - 1]] : [edges[0], edges[edges.length - 1], limit]);
      const pad = 0.04 * (range[1] - range[0]);
      const most = Math.max(...count);
      const svg = picture(width, 170, `Records by ${names[name]}`, `From ${written(edges[0])} to ${written(edges[edges.length - 1])}${limit === null ? "" : `; limit ${limit}`}.`);
      const box = { left: 40, right: width - 12, top: 24, bottom: 140 };
      const { x, y, inside } = axes(svg, box, [range[0] - pad, range[1] + pad], [0, 1.08 * most], {
        xTicks: ticks(range[0] - pad, range[1] + pad, width / 75), yTicks: ticks(0, most, 3).filter(([value]) => Number.isInteger(value)), yName: names[name],
      });
      inside.append(path(count.map((value, k) => (value ? `M${x(edges[k])} ${y(0)}V${y(value)}H${x(edges[k + 1])}V${y(0)}Z` : "")).join(""), "bar"));
      if (limit !== null) inside.append(path(`M${x(limit)} ${box.top}V${box.bottom}`, "limit"));
      holder.append(svg);
    });
  };

  // ---- the page

  const figures = { availability, stresses, decided, intensity, corner, shape, diagnostics };
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
    said.textContent = `${nameOf(chosen)}${data.timed ? `, record ${records.number[chosen]}` : ""}` +
      `${Number.isFinite(speed) ? `; mean wind ${written(speed)} m/s` : ""}; ${flags.length ? `flags: ${flags.join(", ")}` : "no flag"}.`;
    cornerWords();
    chosenTable();
  };
  const choose = (place) => {
    chosen = Math.max(0, Math.min(n - 1, place));
    if (picker) {
      if (picker.tagName === "SELECT") picker.value = String(chosen);
      else if (picker.type === "number") picker.value = String(records.number[chosen]);
      else picker.value = new Date(records.position[chosen]).toISOString().slice(0, 19);
    }
    show();
    holders.filter((holder) => holder.dataset.figure === "corner").forEach(draw);
  };
  holders.forEach(draw);
  show();
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
  new ResizeObserver(() => holders.forEach((holder) => {
    if (Math.abs(holder.clientWidth - (widths.get(holder) || 0)) > 1) draw(holder);
  })).observe(document.body);
})();
