// Points along time at the zoom of the moment: records, or bins of whole hours.

const MOST_RECORDS = 1200;
const MOST_IN_HOURS = 5000; // records that are put into bins of an hour: more take too long to follow a finger
const HOUR = 36e5;
const panels = [...(data.series.ti ? ["ti"] : []), ...data.stresses];
const step = data.step;

/** First and last record of a span; a record counts if some of it is inside. */
const within = ([low, high]) => {
  let first = 0;
  for (let end = n; first < end;) {
    const middle = (first + end) >> 1;
    if (records.position[middle] + step <= low) first = middle + 1; else end = middle;
  }
  let last = first;
  for (let end = n; last < end;) {
    const middle = (last + end) >> 1;
    if (records.position[middle] < high) last = middle + 1; else end = middle;
  }
  return [first, last];
};
const orNull = (value) => (Number.isFinite(value) ? value : null);
/** The numbers of one panel of a record: median, low, high. */
const inPanel = (name, place, numbers) => {
  if (name !== "ti") {
    const c = data.stresses.indexOf(name);
    return [numbers.median[c], numbers.low[c], numbers.high[c]].map(orNull);
  }
  const speed = records.speed[place];
  return [numbers.median[0], numbers.low[0], numbers.high[0]].map((value) => (speed > 0 ? orNull(Math.sqrt(value) / speed) : null));
};
const columnOf = (name) => (name === "ti" ? 0 : data.stresses.indexOf(name));
const noRoom = () => [0, 1].map(() => data.stresses.map(() => []));

/** Each record is a point. */
const ofRecords = (first, last) => {
  const found = { start: [], width: step, binned: false, failed: [], remarked: [], room: data.room ? noRoom() : null, reference: records.reference ? [] : null, of: {} };
  panels.forEach((name) => { found.of[name] = { median: [], low: [], high: [], priors: [] }; });
  for (let place = first; place < last; place += 1) {
    const numbers = numbersOf(place);
    found.start.push(records.position[place]);
    found.failed.push(records.flag[place] & data.failures ? 1 : 0);
    found.remarked.push(records.flag[place] && !(records.flag[place] & data.failures) ? 1 : 0);
    if (found.room) roomOf(place, numbers).forEach((ends, c) => ends.forEach((end, side) => found.room[side][c].push(end)));
    if (records.reference) found.reference.push(orNull(records.reference[place]));
    panels.forEach((name) => {
      const [median, low, high] = inPanel(name, place, numbers);
      const panel = found.of[name];
      panel.median.push(median);
      panel.low.push(low);
      panel.high.push(high);
      panel.priors.push(median === null ? null : isPriors(place, columnOf(name)) ? 1 : 0);
    });
  }
  return found;
};
/** Bins of the clock: medians over the records of their medians and ends of intervals, and where nine tenths of the medians are. */
const inBins = (all, width) => {
  const found = { start: [], width, binned: true, failed: [], remarked: [], room: data.room ? noRoom() : null, reference: all.reference ? [] : null, of: {} };
  panels.forEach((name) => { found.of[name] = { median: [], low: [], high: [], priors: [], spread_low: [], spread_high: [] }; });
  const total = all.start.length;
  for (let from = 0; from < total;) {
    const bin = Math.floor(all.start[from] / width);
    let to = from + 1;
    while (to < total && Math.floor(all.start[to] / width) === bin) to += 1;
    const some = (values) => finite(values.slice(from, to));
    found.start.push(bin * width);
    found.failed.push(some(all.failed).reduce((a, b) => a + b, 0));
    found.remarked.push(some(all.remarked).reduce((a, b) => a + b, 0));
    if (found.room) found.room.forEach((ends, side) => ends.forEach((own, c) => own.push(medianOf(some(all.room[side][c])))));
    if (found.reference) found.reference.push(medianOf(some(all.reference)));
    panels.forEach((name) => {
      const [own, every] = [found.of[name], all.of[name]];
      const medians = some(every.median).sort((a, b) => a - b);
      own.median.push(medians.length ? quantile(medians, 0.5) : null);
      own.spread_low.push(medians.length ? quantile(medians, 0.05) : null);
      own.spread_high.push(medians.length ? quantile(medians, 0.95) : null);
      own.low.push(medianOf(some(every.low)));
      own.high.push(medianOf(some(every.high)));
      const of = some(every.priors);
      own.priors.push(2 * of.reduce((a, b) => a + b, 0) > of.length ? 1 : 0);
    });
    from = to;
  }
  return found;
};
/** The points that the page was given: all of the time. */
const given = (() => {
  const { start, width, binned, failed, remarked, room, reference } = data.series;
  const found = { start, width, binned, failed, remarked, room: data.room ? room : null, reference: reference || null, of: {} };
  data.stresses.forEach((name, c) => {
    found.of[name] = { priors: data.series.priors[c] };
    ["median", "low", "high", ...(binned ? ["spread_low", "spread_high"] : [])].forEach((kind) => { found.of[name][kind] = data.series[kind][c]; });
  });
  if (data.series.ti) found.of.ti = { ...data.series.ti, priors: data.series.priors[0] };
  return found;
})();
const pointsShown = () => {
  if (!given.binned || data.thinned) return given;
  const [first, last] = within(span);
  if (last - first <= MOST_RECORDS) return ofRecords(first, last);
  if (!data.timed || HOUR >= given.width || last - first > MOST_IN_HOURS) return given;
  // whole bins: a bin that the span cuts is that of all its records
  return inBins(ofRecords(...within([Math.floor(span[0] / HOUR) * HOUR, Math.ceil(span[1] / HOUR) * HOUR])), HOUR);
};
