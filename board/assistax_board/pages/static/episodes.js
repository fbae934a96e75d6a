"use strict";
// Plays the episodes that a page names, those that come later too: a film may be made meanwhile.
async function playNamed() {
  for (const place of document.querySelectorAll("[data-episode-from]")) {
    const address = place.dataset.episodeFrom;
    delete place.dataset.episodeFrom;
    const answer = await fetch(address);
    if (answer.ok) playEpisode(place, await unpacked(await answer.arrayBuffer()));
  }
}

new MutationObserver(playNamed).observe(document.getElementById("main"), { childList: true, subtree: true });
playNamed();
