// The shape of the tensor, in Lumley's triangle.

const invariants = (stress) => {
  const [uu, vv, ww, uv, uw, vw] = stress;
  const trace = uu + vv + ww;
  const [a, b, c, d, e, f] = [uu / trace - 1 / 3, vv / trace - 1 / 3, ww / trace - 1 / 3, uv / trace, uw / trace, vw / trace];
  const second = a * a + b * b + c * c + 2 * (d * d + e * e + f * f);
  const third = 3 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)); // 3 det b: the trace of b is 0
  return [Math.cbrt(third / 6), Math.sqrt(second / 6)];
};
const shape = (holder, width) => {
  const { record, xi, eta, priors, words: what } = data.shape;
  const height = 0.72 * width;
  const svg = picture(width, height, "Shape of the tensor: Lumley triangle",
    `${xi.length} records, ${what}; ξ from ${written(Math.min(...xi))} to ${written(Math.max(...xi))}, η from ${written(Math.min(...eta))} to ${written(Math.max(...eta))}.`);
  const box = { left: 46, right: width - 10, top: 24, bottom: height - 44 };
  const { x, y, inside } = axes(svg, box, [-0.2, 0.36], [0, 0.36], { xTicks: ticks(-0.2, 0.36, 6), yTicks: ticks(0, 0.36, 5), xName: "ξ", yName: "η" });
  let edge = `M${x(-1 / 6)} ${y(1 / 6)}L${x(0)} ${y(0)}L${x(1 / 3)} ${y(1 / 3)}`;
  for (let k = 60; k >= 0; k -= 1) {
    const at = -1 / 6 + k / 60 * 0.5;
    edge += `L${x(at)} ${y(Math.sqrt(1 / 27 + 2 * at ** 3))}`;
  }
  [[0, 0, "isotropic", "start", 16, -4], [1 / 3, 1 / 3, "one component", "end", -8, -6], [-1 / 6, 1 / 6, "two, equal", "start", -4, -18]].forEach(
    ([atXi, atEta, words, anchor, dx, dy]) => svg.append(text(x(atXi) + dx, y(atEta) + dy, words, { "text-anchor": anchor })));
  const cloud = path("M0 0", "cloud");
  const mark = path("M0 0", "chosen");
  mark.setAttribute("data-mark", "shape");
  mark.place = () => {
    const posterior = drawsOf(chosen);
    cloud.setAttribute("class", kindOf("cloud", [0, 1, 2].some((c) => isPriors(chosen, c))));
    cloud.setAttribute("d", posterior ? dots(posterior[0].map((_, k) => {
      const [a, b] = invariants(posterior.map((column) => column[k]));
      return [x(a), y(b)];
    })) : "M0 0");
    const k = record.indexOf(records.number[chosen]); // every so many of very many records have a point
    const [a, b] = k >= 0 ? [xi[k], eta[k]] : posterior || !Number.isFinite(numbersOf(chosen).mean[0]) ? [NaN, NaN] : invariants(numbersOf(chosen).mean);
    mark.setAttribute("d", Number.isFinite(a) ? circles([[x(a), y(b)]], 7) : "M0 0");
  };
  mark.place();
  inside.append(cloud, path(`${edge}Z`, "edge"), ...[0, 1].map((kind) => {
    const some = record.map((_, k) => [x(xi[k]), y(eta[k])]).filter((_, k) => priors[k] === kind);
    if (!some.length) return "";
    return kind ? path(circles(some, xi.length > 400 ? 1.5 : 2.5), "dot priors") : path(dots(some), xi.length > 400 ? "dot draws" : "dot");
  }).filter(Boolean), mark);
  holder.append(svg);
};
