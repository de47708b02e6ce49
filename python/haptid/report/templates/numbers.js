// Decoding of the numbers of the page, ticks of axes and formatting.

function numbers(packed) {
  if (packed.f32 === undefined && packed.u16 === undefined) return Float64Array.from({ length: packed.count }, (_, k) => packed.start + k * packed.step);
  if (packed.u16 !== undefined) return levels(packed);
  const bytes = Uint8Array.from(atob(packed.f32), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

// 65535 is a missing value.
function levels(packed) {
  const bytes = Uint8Array.from(atob(packed.u16), (c) => c.charCodeAt(0));
  return Float64Array.from(new Uint16Array(bytes.buffer), (k) => (k === 65535 ? NaN : packed.low + k * packed.step));
}

function shown(value, digits = 4) {
  if (value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const round = Number(value.toPrecision(digits));
  const text = size !== 0 && (size < 1e-3 || size >= 1e5) ? round.toExponential().replace("e+", "e") : String(round);
  return text.replace(/-/g, "−");
}

// About `count` round numbers from low to high.
function ticks(low, high, about) {
  const rough = (high - low) / Math.max(about, 1);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const factors = [0.5, 1, 2, 5, 10];
  const fits = factors.findIndex((m) => m >= 1 && m * power >= rough * 0.999);
  const made = multiples(low, high, factors[fits] * power);
  return made.length > 1 ? made : multiples(low, high, factors[fits - 1] * power); // one number is no scale
}

function multiples(low, high, step) {
  const made = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) made.push(Number((k * step).toPrecision(12)));
  return made;
}

// Powers of ten; also their double and fivefold where there are few.
function logTicks(low, high) {
  const decades = Math.log10(high / low);
  const factors = decades > 3 ? [1] : decades > 1.2 ? [1, 3] : [1, 2, 5];
  const made = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++)
    for (const f of factors) if (f * 10 ** e >= low * 0.999 && f * 10 ** e <= high * 1.001) made.push(Number((f * 10 ** e).toPrecision(6)));
  return decades > 8 ? made.filter((_, k) => k % 3 === 0) : made;
}

function labelled(axis) {
  return axis.unit ? `${axis.label}, ${axis.unit}` : axis.label;
}
