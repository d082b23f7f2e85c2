// Densities of draws, and the contours that hold so much of them.

/** How many areas without a bridge the grid has at a height or above. */
const areas = (grid, size, height) => {
  const left = new Set();
  grid.forEach((value, place) => { if (value >= height) left.add(place); });
  let count = 0;
  for (const start of left) {
    count += 1;
    for (const next = [start]; next.length;) {
      const place = next.pop();
      if (!left.delete(place)) continue;
      const column = place % size;
      next.push(place - size, place + size);
      if (column > 0) next.push(place - 1);
      if (column < size - 1) next.push(place + 1);
    }
  }
  return count;
};
/** Smoothed histogram, and the heights of the contours that hold 68 and 95 %: wider, up to three times, while one has islands. */
const density = (xs, ys, xRange, yRange, size, bounded) => {
  for (let wider = 1.2; ; wider *= 1.2) {
    const found = densityOf(xs, ys, xRange, yRange, size, bounded, wider);
    if (wider > 3 || found.levels.every((height) => areas(found.grid, size, height) < 2)) return found;
  }
};
/** The same with a kernel of so many of Scott's widths; `bounded` says which of x and y are never below the range. */
const densityOf = (xs, ys, xRange, yRange, size, bounded, wider) => {
  const spread = (values, [low, high]) => {
    const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
    const sd = Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / values.length);
    return Math.max(0.8, wider * sd / (high - low) * size * values.length ** (-1 / 6));
  };
  const smooth = (grid, sigma, across, reflects) => {
    const from = (k) => (k < 0 && reflects ? -1 - k : k);
    const reach = Math.ceil(3 * sigma);
    const weights = Array.from({ length: 2 * reach + 1 }, (_, k) => Math.exp(-0.5 * ((k - reach) / sigma) ** 2));
    const sum = weights.reduce((a, b) => a + b, 0);
    const out = new Float64Array(size * size);
    for (let row = 0; row < size; row += 1) {
      for (let column = 0; column < size; column += 1) {
        let total = 0;
        for (let k = -reach; k <= reach; k += 1) {
          const [r, c] = across ? [row, from(column + k)] : [from(row + k), column];
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
  grid = smooth(smooth(grid, spread(xs, xRange), true, bounded[0]), spread(ys, yRange), false, bounded[1]);
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
/** Lines where the grid, 0 beyond its edges, crosses a height: marching squares, the pieces joined so that dashes can be seen. */
const contour = (grid, size, height, x, y) => {
  const at = (row, column) => (row < 0 || column < 0 || row >= size || column >= size ? 0 : grid[row * size + column]);
  const links = new Map(); // crossings by the edge of the grid that they are on
  const places = new Map();
  for (let row = -1; row < size; row += 1) {
    for (let column = -1; column < size; column += 1) {
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
