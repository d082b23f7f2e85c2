// Availability: which share of the expected samples each beam has, over time.

const level = (share) => share <= 0 ? 0 : share < 0.5 ? 1 : share < 0.8 ? 2 : share < 0.95 ? 3 : 4;
const availability = (holder, width) => {
  const { beam, edges, share, usable } = data.availability;
  const cell = Math.max(5, Math.min(22, 240 / beam.length));
  const box = { left: 46, right: width - 18, top: 74, bottom: 74 + cell * beam.length };
  const what = data.availability.of_samples ? "samples used" : "usable beams";
  const all = finite(share.flat());
  const mean = all.reduce((sum, value) => sum + value, 0) / all.length;
  const svg = picture(width, box.bottom + 40, `Availability: share of ${what}, beam by time`,
    `${beam.length} rows, ${edges.length - 1} columns; mean share ${written(100 * mean)} %.`);
  const ends = edges.map((edge) => Math.min(Math.max(edge, span[0]), span[1]));
  const above = { ...box, top: 18, bottom: 60 };
  const usableAxes = axes(svg, above, span, [0, 1], { xTicks: [], yTicks: [[0, "0"], [1, "1"]], yName: "share of usable beams" });
  let outline = `M${usableAxes.x(ends[0])} ${usableAxes.y(0)}`;
  usable.forEach((value, k) => { if (ends[k + 1] > ends[k]) outline += `V${usableAxes.y(value)}H${usableAxes.x(ends[k + 1])}`; });
  usableAxes.inside.append(path(`${outline}V${usableAxes.y(0)}Z`, "band"));
  const every = Math.ceil(13 / cell);
  const { x, inside } = axes(svg, box, span, [0, 1], {
    xTicks: timeTicks(...span, width / 85), yTicks: [], xName: data.timed ? "time (UTC)" : "record",
  });
  const cells = ["", "", "", "", ""];
  share.forEach((row, r) => {
    const top = round(box.top + r * cell);
    for (let k = 0; k < row.length;) {
      let end = k + 1;
      const one = level(row[k]);
      while (end < row.length && level(row[end]) === one) end += 1;
      if (ends[end] > ends[k]) cells[one] += `M${x(ends[k])} ${top}H${x(ends[end])}V${round(top + cell - (cell > 8 ? 1 : 0))}H${x(ends[k])}Z`;
      k = end;
    }
    if (r % every === 0) svg.append(text(box.left - 5, top + cell / 2 + 4, beam[r], { "text-anchor": "end" }));
  });
  cells.forEach((d, k) => { if (d) inside.append(path(d, `level-${k}`)); });
  svg.append(text(12, (box.top + box.bottom) / 2, "beam", { "text-anchor": "middle", transform: `rotate(-90 12 ${(box.top + box.bottom) / 2})` }));
  alongTime(svg, { ...box, top: above.top }, width);
  holder.append(svg);
};
