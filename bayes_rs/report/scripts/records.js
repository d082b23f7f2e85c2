// The records: their numbers, draws, names and flags; one of them is chosen.

const packed = data.records;
const records = {
  number: stepsOf(packed.record),
  position: stepsOf(packed.position),
  time: packed.time ? stepsOf(packed.time) : null,
  turbine: packed.turbine ? { names: packed.turbine.names, place: new Uint16Array(bytes(packed.turbine.place)) } : null,
  flag: Array.from(new Uint16Array(bytes(packed.flag.place)), (place) => packed.flag.values[place]),
  speed: new Float32Array(bytes(packed.speed)),
  numbers: rowsOf(packed.numbers),
  correlation: new Int8Array(bytes(packed.correlation)),
  priors: new Uint8Array(bytes(packed.priors)),
  decided: packed.decided ? new Int8Array(bytes(packed.decided)) : null,
  beside: packed.beside ? rowsOf(packed.beside) : null,
  reference: packed.reference ? new Float32Array(bytes(packed.reference)) : null,
};
const n = records.number.length;
const N_PAIR = 15;
const pairAt = new Int8Array(36); // of two stresses, the place of their correlation
for (let i = 0, pair = 0; i < 6; i += 1) for (let j = i + 1; j < 6; j += 1, pair += 1) pairAt[6 * i + j] = pairAt[6 * j + i] = pair;
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
/** Whether a stress of a record is mostly the prior's. */
const isPriors = (place, column) => ((records.priors[place] >> column) & 1) === 1;
const correlationAt = (place, i, j) => {
  const value = records.correlation[place * N_PAIR + pairAt[6 * i + j]];
  return value === -128 ? NaN : value / 100;
};
/** The prior's intervals at the size uu + vv + ww of a record: low and high of each stress. */
const roomOf = (place, { mean, sd }) => {
  const size = mean[0] + mean[1] + mean[2];
  let variance = sd[0] ** 2 + sd[1] ** 2 + sd[2] ** 2;
  for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) variance += 2 * (correlationAt(place, i, j) || 0) * sd[i] * sd[j];
  const { spread, low, high } = data.room;
  const at = Math.sqrt(Math.max(variance, 0)) / size / spread[spread.length - 1] * (spread.length - 1);
  if (!Number.isFinite(at)) return data.stresses.map(() => [null, null]);
  const below = Math.min(Math.floor(at), spread.length - 2);
  return data.stresses.map((_, c) => [low, high].map((ends) => size * (ends[c][below] + (at - below) * (ends[c][below + 1] - ends[c][below]))));
};
/** Start of a record, ms since 1970; NaN where it has none. */
const startOf = (place) => (data.timed ? records.position[place] : records.time ? records.time[place] : NaN);
const turbineOf = (place) => (records.turbine ? records.turbine.names[records.turbine.place[place]] : "");
/** Where the records of a turbine stand, which follow each other: that of a record's turbine along the axis of numbers. */
const turbineSpan = (index) => [records.position[records.turbine.place.indexOf(index)], records.position[records.turbine.place.lastIndexOf(index)] + data.step];
const nameOf = (place) => {
  const start = startOf(place);
  const name = Number.isFinite(start) ? `${stamp(start)} UTC` : `record ${records.number[place]}`;
  return turbineOf(place) ? `${turbineOf(place)}, ${name}` : name;
};
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
/** The record whose position is nearest. */
const nearest = (position) => {
  let low = 0;
  let high = n - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (records.position[middle] <= position) low = middle; else high = middle;
  }
  return position - records.position[low] <= records.position[high] - position ? low : high;
};
/** What stands beneath the axis of numbers: the start of the record there, if it has one. */
const placeWords = (value, words) => {
  const place = nearest(value);
  const start = records.position[place] === value ? startOf(place) : NaN;
  return Number.isFinite(start) ? stamp(start).slice(5, 16) : words;
};
let chosen = packed.first;
