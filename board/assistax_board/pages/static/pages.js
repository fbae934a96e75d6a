"use strict";
// What works without scripts, a little better: the choice of colours is kept from page to page,
// and a page about something unfinished looks again by itself.

const THEME = "assistax-zoo-theme";

function keepTheme() {
  const kept = localStorage.getItem(THEME) ?? "auto";
  const chosen = document.querySelector(`.theme input[value="${CSS.escape(kept)}"]`);
  if (chosen) chosen.checked = true;
  delete document.documentElement.dataset.theme; // from here on the checked choice decides
  document.querySelector(".theme")?.addEventListener("change", (event) => {
    localStorage.setItem(THEME, event.target.value);
  });
}

async function lookAgain() {
  const shown = document.querySelector("#live[data-live]");
  if (!shown) return;
  try {
    const answer = await fetch(location.href, { headers: { Accept: "text/html" } });
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const fresh = page.getElementById("live");
    if (answer.ok && fresh && fresh.innerHTML !== shown.innerHTML) shown.replaceWith(fresh);
  } catch {
    // The server is away for a moment; the next look may find it.
  }
  setTimeout(lookAgain, 3000);
}

// Before the first paint: the choice that is not drawn yet.
document.documentElement.dataset.theme = localStorage.getItem(THEME) ?? "auto";
document.addEventListener("DOMContentLoaded", () => {
  keepTheme();
  setTimeout(lookAgain, 3000);
});
