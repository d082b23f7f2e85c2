// The campaign: means of the stresses, turbulence intensity by wind speed, and hyperparameters on their prior.

/** Points with whiskers, those of the prior hollow and grey. */
const whiskers = (inside, at, priors, kind = "") => [0, 1].forEach((one) => {
  const some = at.filter(([, y], k) => priors[k] === one && Number.isFinite(y));
  if (!some.length) return;
  const lines = some.map(([x, , low, high]) => (Number.isFinite(low) ? `M${x} ${low}V${high}` : "")).join("");
  if (lines) inside.append(path(lines, kindOf(`whisker strong ${kind}`.trim(), one)));
  inside.append(path(circles(some, 3.5), kindOf(`point ${kind}`.trim(), one)));
});
const campaignMeans = (holder, width) => {
  const { mean, low, high, priors, average, prior_name: name } = data.campaign.means;
  const [bottom, top] = extent([0, ...low, ...high, ...finite(average)]);
  const margin = 0.06 * (top - bottom || 1);
  const svg = picture(width, 250, `Means of the stresses over the campaign, ${unit}`,
    data.stresses.map((one, c) => `${one} ${withInterval(mean[c], low[c], high[c], priors[c])}`).join("; "));
  const box = { left: 46, right: width - 12, top: 24, bottom: 214 };
  const { x, y, inside } = axes(svg, box, [-0.6, 5.6], [bottom - margin, top + margin], {
    xTicks: data.stresses.map((one, c) => [c, `${one}${priors[c] ? "*" : ""}`]), yTicks: ticks(bottom, top, 5), yName: `mean, ${unit}`,
  });
  inside.append(path(`M${box.left} ${y(0)}H${box.right}`, "zero"));
  whiskers(inside, mean.map((value, c) => [round(x(c) - 5), y(value), y(low[c]), y(high[c])]), priors);
  const squares = average.map((value, c) => (value === null ? "" : `M${round(x(c) + 3)} ${round(y(value) - 3.5)}h7v7h-7Z`)).join("");
  if (squares) inside.append(path(squares, "average"));
  svg.querySelector("desc").textContent += `; squares: averages of the records' own means under the prior ${name}`;
  holder.append(svg);
};
const campaignSpeed = (holder, width) => {
  const { ti, ti_p90: high90 } = data.campaign;
  const beside = data.reference ? data.reference.bins : null;
  const speeds = [...ti.speed, ...high90.speed, ...(beside ? beside.speed : [])];
  const range = extent(speeds);
  const top = Math.max(...finite([...ti.high, ...high90.high, ...(beside ? beside.theirs : [])])) * 1.06;
  const svg = picture(width, 270, "Turbulence intensity by wind speed, of the campaign",
    ti.speed.map((speed, k) => `${written(speed)} m/s: ${withInterval(ti.mean[k], ti.low[k], ti.high[k], ti.priors[k])}`).join("; "));
  const box = { left: 46, right: width - 12, top: 24, bottom: 226 };
  const { x, y, inside } = axes(svg, box, [range[0] - 0.7, range[1] + 0.7], [0, top], {
    xTicks: ticks(range[0] - 0.7, range[1] + 0.7, width / 60).filter(([value]) => value >= 0), yTicks: ticks(0, top, 5), xName: "wind speed, m/s", yName: "σ_u/U",
  });
  const of = (rows, shift) => rows.speed.map((speed, k) => [round(x(speed) + shift), y(rows.mean[k]), y(rows.low[k]), y(rows.high[k])]);
  whiskers(inside, of(high90, 3), high90.priors, "high");
  whiskers(inside, of(ti, -3), ti.priors);
  if (beside) inside.append(path(beside.speed.map((speed, k) => `M${x(speed - 0.5)} ${y(beside.theirs[k])}H${x(speed + 0.5)}`).join(""), "reference"));
  holder.append(svg);
};
const campaignHyper = (holder, width) => {
  const { name, low, mean, high, priors, words } = data.campaign.hyper;
  const small = width < 760;
  const row = small ? 34 : 20;
  const left = small ? 8 : 236;
  const right = small ? width - 8 : width - 262;
  const svg = picture(width, 46 + row * name.length, "Hyperparameters: posterior on its prior", `${name.length} rows; the prior's interval goes from −1 to 1.`);
  if (small) svg.setAttribute("class", "small");
  const box = { left, right, top: 6, bottom: 6 + row * name.length };
  const range = extent([-1.1, 1.1, ...low, ...high]);
  const { x, inside } = axes(svg, box, range, [name.length, 0], { xTicks: ticks(...range, 6), yTicks: [], xName: "in units of the prior's interval" });
  inside.append(path(`M${x(-1)} ${box.top}H${x(1)}V${box.bottom}H${x(-1)}Z`, "room"));
  name.forEach((one, k) => {
    const at = box.top + row * (k + (small ? 0.72 : 0.5));
    inside.append(path(`M${x(low[k])} ${at}H${x(high[k])}`, kindOf("size", priors[k])), path(circles([[x(mean[k]), at]], 3), kindOf("size", priors[k])));
    if (small) svg.append(text(left + 3, at - 9, `${one}: ${words[k]}`));
    else svg.append(text(left - 6, at + 4, one, { "text-anchor": "end" }), text(right + 6, at + 4, words[k]));
  });
  holder.append(svg);
};
