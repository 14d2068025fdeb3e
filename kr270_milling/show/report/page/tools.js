// The page of each tool in a separate frame, made when its tab is chosen for the first time.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const plotly = document.getElementById("plotly").textContent;
  const tabs = [...document.querySelectorAll("#tabs button")], frames = {};
  function show(tool) {
    if (!frames[tool]) {
      const frame = frames[tool] = document.createElement("iframe");
      frame.title = `report of ${tool}`;
      frame.srcdoc = data.pages[tool].split(data.mark).join(plotly);
      document.getElementById("pages").append(frame);
    }
    for (const tab of tabs) tab.setAttribute("aria-selected", String(tab.dataset.tool === tool));
    for (const [name, frame] of Object.entries(frames)) frame.hidden = name !== tool;
  }
  for (const tab of tabs) tab.addEventListener("click", () => show(tab.dataset.tool));
  show(tabs.find((tab) => tab.getAttribute("aria-selected") === "true").dataset.tool);
})();
