// The page of a fit at several ranges: the profile of all records or of one, and links that keep the record.

const holder = document.querySelector("[data-figure=profile]");
const profilePicker = document.getElementById("pick");
let drawnAt = 0;
const drawProfile = () => {
  drawnAt = holder.clientWidth;
  if (drawnAt < 50) return;
  holder.replaceChildren();
  profile(holder, drawnAt);
};
const profileAddress = () => {
  if (shownProfile < 0) return "";
  const start = packedProfiles.time[shownProfile];
  return Number.isFinite(start) ? `#${isoOf(start)}` : `#record-${packedProfiles.number[shownProfile]}`;
};
const showProfile = (place, { told = false } = {}) => {
  shownProfile = Math.max(-1, Math.min(nProfile - 1, place));
  if (profilePicker) profilePicker.value = String(shownProfile);
  if (!told) writeAddress(profileAddress() || "#profile");
  document.querySelectorAll("a[data-page]").forEach((link) => { link.href = link.dataset.page + profileAddress(); });
  drawProfile();
  const box = document.getElementById("profile-table");
  const all = profileOf(shownProfile);
  box.replaceChildren(tableOf(
    `${profileName(shownProfile)}: turbulence intensity and stresses, ${unit}, each with its ${percent} interval, ${data.interval}; *: mostly the prior's`,
    [data.profile.upright ? "height, m" : "range, m", ...names.map((name) => (name === "ti" ? "TI" : name))],
    data.profile.place.map((at, r) => [written(at), ...all.map(({ estimate, low, high, priors }) => withInterval(estimate[r], low[r], high[r], priors[r]))]),
  ));
};
const findProfile = ({ turbine, ms, number }) => {
  if (!nProfile) return "This page holds no single records: open the page of a range.";
  if (turbine) return `There is no turbine ${turbine} in this page.`;
  if (number !== undefined) {
    const place = packedProfiles.number.indexOf(number);
    return place >= 0 ? place : `There is no record ${number} in this page.`;
  }
  const late = Array.from(packedProfiles.time, (start) => ms - start);
  const place = late.findIndex((one) => one >= 0 && one < data.duration);
  if (place >= 0) return place;
  const best = late.reduce((kept, one, k) => (Number.isFinite(one) && (kept < 0 || Math.abs(one) < Math.abs(late[kept])) ? k : kept), -1);
  if (best < 0) return "The records of this page have no times: write #record-12 for one of them.";
  return `No record here holds ${stamp(ms)} UTC; the nearest begins at ${profileName(best)}.`;
};
if (holder) {
  showProfile(-1, { told: true });
  if (profilePicker) {
    profilePicker.addEventListener("input", () => showProfile(Number(profilePicker.value)));
    document.getElementById("previous").addEventListener("click", () => showProfile(shownProfile - 1));
    document.getElementById("next").addEventListener("click", () => showProfile(shownProfile + 1));
  }
  followAddress(findProfile, (place) => showProfile(place, { told: true }));
  new ResizeObserver(() => { if (Math.abs(holder.clientWidth - drawnAt) > 1) drawProfile(); }).observe(document.body);
}
