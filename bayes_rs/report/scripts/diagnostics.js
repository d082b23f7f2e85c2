// Records by their diagnostics.

const names = { ess_bulk: "bulk ESS (least)", ess_tail: "tail ESS (least)", r_hat: "R-hat (largest)", pareto_k: "Pareto k", misfit: "misfit, sd" };
const diagnostics = (holder, full) => {
  const width = panelWidth(holder, full);
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
