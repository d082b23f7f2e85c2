// The address of a record: #2020-09-04T12:00, #T07/2020-09-04T12:00, or #record-12.

const addressWords = document.getElementById("address");
const sayAddress = (words) => {
  addressWords.textContent = words;
  addressWords.hidden = words === "";
};
const isoOf = (ms) => new Date(ms).toISOString().slice(0, 19).replace(/:00$/, "");
/** What a hash asks for: a turbine and a time (ms), or a number; null where it is of neither form. */
const readAddress = (hash) => {
  let words;
  try {
    words = decodeURIComponent(hash.replace(/^#/, ""));
  } catch {
    return null;
  }
  const counted = /^record-(\d+)$/.exec(words);
  if (counted) return { number: Number(counted[1]), turbine: "" };
  const cut = words.lastIndexOf("/");
  const [turbine, time] = [words.slice(0, Math.max(cut, 0)), words.slice(cut + 1)];
  const parts = /^(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d)(:\d\d(?:\.\d+)?)?Z?$/.exec(time);
  const ms = parts ? Date.parse(`${parts[1]}T${parts[2]}${parts[3] || ":00"}Z`) : NaN;
  return Number.isFinite(ms) ? { turbine, ms } : null;
};
/** Put a record's address in place of the page's, without a step to go back. */
const writeAddress = (hash) => {
  try {
    history.replaceState(null, "", hash);
  } catch { /* a page inside another has no address of its own */ }
  sayAddress("");
};
/** Follow the address that the page was opened with, and each that is typed later. */
const followAddress = (find, follow) => {
  const go = () => {
    const { hash } = location;
    sayAddress("");
    let id = hash.slice(1);
    try { id = decodeURIComponent(id); } catch { /* as it stands */ }
    if (hash.length < 2 || document.getElementById(id)) return;
    const asked = readAddress(hash);
    const found = asked ? find(asked) : `The address ends in ${hash}, which is neither a section nor a record: write #2020-09-04T12:00.`;
    if (typeof found === "string") sayAddress(found); else follow(found);
  };
  window.addEventListener("hashchange", go);
  go();
};
