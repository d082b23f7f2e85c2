// The posterior of the chosen record: a corner plot, and tables.

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
const correlationOf = (i, j) => correlationAt(chosen, i, j);
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
  const called = (c) => `${data.stresses[c]}${isPriors(chosen, c) ? "*" : ""}`;
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
  const beneath = (c) => [4, 3].map((most) => near(c, most)).find((some) => some.reduce((sum, [, words]) => sum + 8 * words.length + 6, 0) < cell) || near(c, 2);
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
        inside.append(path(`M${x(numbers.low[c])} ${box.top}H${x(numbers.high[c])}V${box.bottom}H${x(numbers.low[c])}Z`, kindOf("outer", isPriors(chosen, c))));
        inside.append(path(`${outline(heights, ranges[c], x, y)}Z`, kindOf("band", isPriors(chosen, c))));
        inside.append(path(outline(heights, ranges[c], x, y), kindOf("middle", isPriors(chosen, c))));
        if (before) inside.append(path(outline(before, ranges[c], x, y), "prior"));
        inside.append(path(`M${x(numbers.median[c])} ${box.top}V${box.bottom}`, "zero"));
        svg.append(text(box.left + cell / 2, box.top - 5, small ? called(c) : `${called(c)} ${written(numbers.median[c], 2)}`, { "text-anchor": "middle", class: "strong" }));
      } else {
        const y = scale(ranges[row], [box.bottom, box.top]);
        const both = isPriors(chosen, row) || isPriors(chosen, column); // one of the two is the prior's
        const size = small ? 24 : 36;
        const inCell = [scale([0, size], [box.left, box.right]), scale([0, size], [box.bottom, box.top])];
        const contours = (columns, kind) => {
          if (!columns) return;
          const { grid, levels } = density(columns[column], columns[row], ranges[column], ranges[row], size, [column < 3, row < 3]);
          const d = levels.map((height) => contour(grid, size, height, ...inCell)).join("");
          if (d) inside.append(path(d, kind));
        };
        if (posterior) {
          inside.append(path(dots(posterior[column].map((value, k) => [x(value), y(posterior[row][k])])), kindOf("dot draws", both)));
          contours(posterior, kindOf("middle", both));
        } else {
          const [mean, sd] = [[numbers.mean[column], numbers.mean[row]], [numbers.sd[column], numbers.sd[row]]];
          inside.append(path(ellipse(mean, sd, correlationOf(column, row), 0.95, x, y), kindOf("outer", both)));
          inside.append(path(ellipse(mean, sd, correlationOf(column, row), 0.68, x, y), kindOf("band", both)));
          inside.append(path(dots([[x(mean[0]), y(mean[1])]]), kindOf("dot", both)));
        }
        contours(shapes, "prior");
        if (column === 0) {
          for (const [value, words] of near(row, small ? 2 : 4)) svg.append(text(box.left - 3, y(value) + 4, words, { "text-anchor": "end" }));
        }
      }
      if (row === 5) {
        for (const [value, words] of small ? near(column, 2) : beneath(column)) svg.append(text(x(value), box.bottom + 13, words, { "text-anchor": "middle" }));
        svg.append(text(box.left + cell / 2, box.bottom + (small ? 27 : 30), called(column), { "text-anchor": "middle", class: "strong" }));
      }
      svg.append(path(`M${box.left} ${box.top}H${box.right}V${box.bottom}H${box.left}Z`, "frame"));
    }
  }
  svg.append(text(left + 3 * (cell + gap), 20 + 6 * cell + 5 * gap + foot - 4, `all axes in ${unit}`, { "text-anchor": "middle" }));
  holder.append(svg);
};
const cornerWords = () => {
  const holder = document.getElementById("corner-words");
  if (!holder) return;
  const posterior = drawsOf(chosen);
  holder.replaceChildren();
  if (posterior) {
    const measured = data.stresses.filter((_, c) => !isPriors(chosen, c)).length;
    holder.append(key(kindOf("dot", measured < 2), `${posterior[0].length} draws of the posterior, contours hold 68 and 95 %`));
  } else {
    holder.append(key("band", "68 %"), key("outer", "95 % of a Gaussian with the posterior's mean and covariance: the draws are not in this page, and the posterior itself is realizable and skewed"));
  }
  holder.append(key("hatch", "hatched grey (names with *): mostly the prior's"));
  if (prior) holder.append(key("prior", "prior at the posterior's size: where the posterior fills it, the data said nothing of the shape"));
  holder.append(key("outer", `in the panels on the diagonal, the ${percent} interval, ${data.interval}; dotted, the median`));
};
const chosenTable = () => {
  const holder = document.getElementById("chosen-table");
  if (!holder) return;
  const numbers = numbersOf(chosen);
  const priors = (row) => isPriors(chosen, row) && Number.isFinite(numbers.median[row]);
  const tables = [tableOf(
    `Posterior of ${nameOf(chosen)}, ${unit}, with the ${percent} interval, ${data.interval}; *: mostly the prior's`,
    ["stress", "median", `${percent} from`, "to", "decided by", "mean", "sd", ...data.stresses.slice(1).map((name) => `corr. ${name}`)],
    data.stresses.map((name, row) => [
      `${name}${priors(row) ? "*" : ""}`,
      ...[numbers.median, numbers.low, numbers.high].map((column) => written(column[row])),
      Number.isFinite(numbers.median[row]) ? (priors(row) ? "prior" : "data") : "–",
      ...[numbers.mean, numbers.sd].map((column) => written(column[row])),
      ...[1, 2, 3, 4, 5].map((column) => (row < column ? fixed(correlationOf(row, column)) : "")),
    ]),
  )];
  if (records.decided) {
    const share = (row) => records.decided[6 * chosen + row];
    tables.push(tableOf(
      `What the data decided of ${nameOf(chosen)} (1: the data's, 0: the prior's), and least squares on the same variances, ${unit}`,
      ["stress", "decided", "least squares", "its standard error"],
      data.stresses.map((name, row) => [
        name, share(row) === -128 ? "–" : fixed(share(row) / 100), ...[0, 6].map((offset) => written(unpacked(records.beside, chosen, 6, offset)[row])),
      ]),
    ));
  }
  holder.replaceChildren(...tables);
};
