// Ticks of axes: round numbers, and whole steps of the clock.

const niceStep = (span, most) => {
  const rough = span / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
};
const ticks = (low, high, most) => {
  const step = niceStep(high - low || 1, most);
  const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
    found.push([k * step, (k * step).toFixed(places).replace(/^-(?=0\.?0*$)/, "").replace("-", "−")]);
  }
  return found;
};
const timeTicks = (low, high, most) => {
  if (!data.timed) return ticks(low, high, most).filter(([value]) => Number.isInteger(value)).map(([value, words]) => [value, placeWords(value, words)]);
  const steps = [1 / 1440, 1 / 288, 1 / 144, 1 / 48, 1 / 24, 1 / 12, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 7, 14].map((days) => days * DAY);
  const step = steps.find((one) => (high - low) / one <= most);
  const found = [];
  if (step === undefined) {
    const months = [1, 2, 3, 6, 12, 24, 60, 120].find((one) => (high - low) / (one * 30 * DAY) <= most) || 240;
    const first = new Date(low);
    for (let year = first.getUTCFullYear(), month = 0; ; month += months) {
      const at = Date.UTC(year, month, 1);
      if (at > high) break;
      if (at >= low) found.push([at, new Date(at).toISOString().slice(0, 7)]);
    }
    return found;
  }
  for (let at = Math.ceil(low / step) * step; at <= high; at += step) {
    const text = new Date(at).toISOString();
    found.push([at, step >= DAY || at % DAY === 0 ? text.slice(5, 10) : text.slice(11, 16)]);
  }
  return found;
};
