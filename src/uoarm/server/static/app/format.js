// Numbers and times as short text.

const SINCE = 946684800; // 2000: what is less is a duration, or the time of a simulation
const UNITS = [[1e9, "G"], [1e6, "M"], [1e3, "k"]];

/** 1234567 as "1.23 M"; what is below a thousand keeps at most three figures. */
export const short = (number) => (number === null || number === undefined ? "–" : rounded(number, 3));

/** Labels of an axis: short, with as many figures as tell them apart; "" of what is not finite. */
export function labels(numbers) {
  const finite = numbers.filter(Number.isFinite);
  let figures = 3;
  const isSame = () => new Set(finite.map((number) => rounded(number, figures))).size < finite.length;
  while (figures < 17 && isSame()) figures += 1;
  return numbers.map((number) => (Number.isFinite(number) ? rounded(number, figures) : ""));
}

/** A number that one points at: 1013.25 in full, and the seconds of 1796104560.25. */
export const fine = (number) => Number(number.toPrecision(Math.abs(number) < 1e6 ? 6 : 10)).toString();

function rounded(number, figures) {
  const given = Math.abs(number) < 1e21 && UNITS.find(([limit]) => Math.abs(number) >= limit);
  const [size, unit] = given || [1, ""]; // beyond, as "1e+40"
  const text = Number((number / size).toPrecision(figures)).toString();
  return unit ? `${text} ${unit}` : text;
}

export const rate = (perSecond) => (perSecond == null ? "–" : `${short(perSecond)}/s`);

/** Seconds as "3 ms", "1.2 s", "4 min", "2 h". */
export function span(seconds) {
  if (seconds == null) return "–";
  if (seconds < 0.9995) return `${Math.max(0, Math.round(seconds * 1000))} ms`;
  if (seconds < 59.95) return `${Number(seconds.toFixed(1))} s`;
  if (seconds < 3570) return `${Math.round(seconds / 60)} min`;
  return `${Number((seconds / 3600).toFixed(1))} h`;
}

/** A Date as "14:03:07". */
export const clock = (date) => date.toLocaleTimeString("en-GB", { hour12: false });

export const noun = (count, word) => (count === 1 ? word : `${word}s`);

/** A number of things: plural(1, "drop") is "1 drop". */
export const plural = (count, word) => `${short(count)} ${noun(count, word)}`;

/** Whether a value is a time or a duration of ROS or OpenRTM, of which no line is drawn. */
export function isTime(value) {
  if (value === null || typeof value !== "object" || Object.keys(value).length !== 2) return false;
  return ("sec" in value && ("nanosec" in value || "nsec" in value)) || ("secs" in value && "nsecs" in value);
}

const parted = (value) => [value.sec ?? value.secs, value.nanosec ?? value.nsec ?? value.nsecs];

/** When a message says it is of, in seconds; null: it does not say. */
export function timeOf(message) {
  const found = [message?.header?.stamp, message?.stamp, message?.timestamp, message?.tm].find(isTime);
  const [seconds, parts] = found ? parted(found).map(Number) : [];
  return seconds > 0 || parts > 0 ? seconds + parts / 1e9 : null;
}

/** A time as "2026-11-26 18:02:03.250 UTC"; null: it is none, or a duration. */
export function stamp(value) {
  if (!isTime(value)) return null;
  const [seconds, parts] = parted(value);
  if (!(seconds >= SINCE) || !(parts >= 0)) return null;
  return `${new Date(seconds * 1000 + parts / 1e6).toISOString().replace("T", " ").replace("Z", "")} UTC`;
}

/** What a person decides about: all of it, and nothing that is not seen or that turns text around. */
export const exact = (message) =>
  JSON.stringify(message, null, 2).replace(/[\p{Cc}\p{Cf}\p{Zl}\p{Zp}]/gu, (sign) =>
    sign === "\n" ? sign : `\\u{${sign.codePointAt(0).toString(16)}}`);

/** Any message as indented text, cut where it is long: lists, strings, the whole. Times are times. */
export function pretty(message, { items = 40, letters = 200, whole = 20000 } = {}) {
  const cut = (_, value) => {
    const time = stamp(value);
    if (time !== null) return time;
    if (typeof value === "string" && value.length > letters) {
      return `${value.slice(0, letters)}… (${short(value.length)} characters)`;
    }
    if (Array.isArray(value) && value.length > items) {
      return [...value.slice(0, items), `… ${short(value.length - items)} more`];
    }
    return value;
  };
  const text = JSON.stringify(message, cut, 2) ?? "nothing";
  return text.length > whole ? `${text.slice(0, whole)}\n…` : text;
}
