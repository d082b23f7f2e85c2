// The page's data; numbers read from them, and written for people.

const data = JSON.parse(document.getElementById("data").textContent);
const DAY = 864e5;
const percent = data.prob ? `${+(100 * data.prob).toPrecision(4)} %` : "";
const unit = "m² s⁻²";

const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
const rowsOf = (packed) => ({ values: new Int16Array(bytes(packed.values)), unit: new Float32Array(bytes(packed.unit)) });
const stepsOf = ({ values, first, step, n: count }) =>
  values ? new Float64Array(bytes(values)) : Float64Array.from({ length: count }, (_, k) => first + k * step);
const finite = (values) => values.filter((value) => value !== null && Number.isFinite(value));
const written = (value, digits = 3) => {
  if (value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(digits - 1).replace(/-/g, "−");
  const places = size === 0 ? digits - 1 : Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return value.toFixed(places).replace(/-/g, "−");
};
const fixed = (value) => (Number.isFinite(value) ? value.toFixed(2).replace(/^-(?=0\.00)/, "").replace("-", "−") : "–");
const stamp = (ms) => new Date(ms).toISOString().slice(0, 19).replace("T", " ").replace(/:00$/, "");
const quantile = (sorted, q) => {
  const place = q * (sorted.length - 1);
  const below = Math.floor(place);
  const above = Math.min(below + 1, sorted.length - 1);
  return sorted[below] + (place - below) * (sorted[above] - sorted[below]);
};
const medianOf = (values) => (values.length ? quantile(values.sort((a, b) => a - b), 0.5) : null);
const extent = (values) => values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
