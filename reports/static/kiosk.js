// Shows the page anew when the server says that something has changed, and says so when the server is gone.
"use strict";
(function () {
  const board = document.getElementById("board");
  const lost = document.getElementById("lost");
  const counts = document.getElementById("counts");
  async function load() {
    const answer = await fetch("./", { cache: "no-store" });
    if (!answer.ok) return;
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    board.replaceChildren(...page.getElementById("board").childNodes);
    counts.replaceChildren(...page.getElementById("counts").childNodes);
    document.title = page.title;
  }
  const news = new EventSource("events");
  news.addEventListener("changed", () => { load().catch(() => { lost.hidden = false; }); });
  news.addEventListener("open", () => { lost.hidden = true; });
  news.addEventListener("error", () => { lost.hidden = false; });
})();
