// What the data decided of each stress: grey where it is less than half in the median record.

const decided = (holder, width) => {
  const { points, priors, limit } = data.decided;
  const low = Math.max(Math.min(0, ...finite(points.flat())), -1);
  const svg = picture(width, 220, "What the data decided of each stress",
    data.stresses.map((name, k) => `${name} ${written(points[k][1], 2)}`).join("; "));
  const box = { left: 40, right: width - 14, top: 10, bottom: 180 };
  const { x, y, inside } = axes(svg, box, [low - 0.03, 1.03], [6, 0], {
    xTicks: ticks(low, 1, width / 70), yTicks: [], xName: "0: the prior decided, 1: the data did",
  });
  inside.append(path(`M${box.left} ${box.top}H${x(limit)}V${box.bottom}H${box.left}Z`, "room"));
  inside.append(path(`M${x(0)} ${box.top}V${box.bottom}M${x(1)} ${box.top}V${box.bottom}`, "zero"));
  data.stresses.forEach((name, k) => {
    const [from, middle, to] = points[k];
    const at = y(k + 0.5);
    svg.append(text(box.left - 6, at + 4, name, { "text-anchor": "end", class: "strong" }));
    if (middle === null) return;
    inside.append(path(`M${x(Math.max(from, low))} ${at}H${x(to)}`, kindOf("size", priors[k])));
    inside.append(path(circles([[x(middle), at]], 4), kindOf("size", priors[k])));
  });
  holder.append(svg);
};
