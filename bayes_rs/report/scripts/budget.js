// The uncertainty budget: a bar for each stress, of the shares of its variance.

const budget = (holder, width) => {
  const { names, u, priors, sources } = data.budget;
  const ends = names.map((_, k) => sources.reduce(([below, above], { share }) => [below + Math.min(share[k], 0), above + Math.max(share[k], 0)], [0, 0]));
  const low = Math.min(0, ...ends.map(([below]) => below));
  const high = Math.max(100, ...ends.map(([, above]) => above));
  const row = 30;
  const svg = picture(width, 44 + row * names.length, "Shares of each stress's variance by source",
    names.map((name, k) => `${name}: ${sources.map((one) => `${one.name} ${written(one.share[k], 2)} %`).join(", ")}`).join("; "));
  const box = { left: 40, right: width - 76, top: 10, bottom: 10 + row * names.length };
  const { x, y, inside } = axes(svg, box, [low < 0 ? low - 2 : 0, high + 1], [names.length, 0], {
    xTicks: ticks(low, high, width / 70), yTicks: [], xName: "share of the variance, %",
  });
  names.forEach((name, k) => {
    const [top, bottom] = [y(k + 0.16), y(k + 0.84)];
    let [below, above] = [0, 0];
    sources.forEach(({ kind, share }) => {
      const from = share[k] < 0 ? below : above;
      const to = from + share[k];
      if (share[k] < 0) below = to;
      else above = to;
      if (x(to) !== x(from)) inside.append(path(`M${x(from)} ${top}H${x(to)}V${bottom}H${x(from)}Z`, `part ${kind}`));
    });
    svg.append(
      text(box.left - 6, y(k + 0.5) + 4, name, { "text-anchor": "end", class: priors[k] ? "" : "strong" }),
      text(box.right + 6, y(k + 0.5) + 4, `u ${u[k]}`),
    );
  });
  inside.append(path(`M${x(0)} ${box.top}V${box.bottom}`, "zero"));
  holder.append(svg);
};
