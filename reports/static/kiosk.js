// Shows the page anew when the server says that something has changed, and says so when the server is gone.
// Where the device's session has ended, the server leads to the login instead.
"use strict";
(function () {
  const board = document.getElementById("board");
  const lost = document.getElementById("lost");
  const counts = document.getElementById("counts");
  async function load() {
    const answer = await fetch("./", { cache: "no-store" });
    if (answer.redirected) return location.replace(answer.url);
    if (!answer.ok) throw new Error(answer.status);
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    board.replaceChildren(...page.getElementById("board").childNodes);
    counts.replaceChildren(...page.getElementById("counts").childNodes);
    document.title = page.title;
  }
  const show = () => { load().catch(() => { lost.hidden = false; }); };
  const news = new EventSource("events");
  news.addEventListener("changed", show);
  news.addEventListener("open", () => { lost.hidden = true; });
  news.addEventListener("error", show);
})();
