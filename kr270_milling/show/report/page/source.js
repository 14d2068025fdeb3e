/* The lines of the tool path file; the one that is run at the place is marked. */
(() => {
  const { linked } = KR.data;
  KR.startSource = () => {
    const list = KR.by("source");
    if (!list) return;
    const first = new Map();
    linked.line.forEach((line, i) => { if (line && !first.has(line)) first.set(line, i); });
    const items = new Map();
    let last = 0;
    for (const { number, text } of linked.source) {
      if (last && number > last + 1) list.append(Object.assign(KR.make("li", "⋮"), { className: "none" }));
      const item = KR.make("li", text || " ");
      item.dataset.n = number;
      if (first.has(number)) item.addEventListener("click", () => KR.go(first.get(number)));
      else item.className = "none";
      items.set(number, item);
      list.append(item);
      last = number;
    }
    let here = null;
    KR.pictures.push({ draw() {}, mark(i) {
      const item = items.get(linked.line[i]);
      if (item === here) return;
      here?.classList.remove("here");
      here?.removeAttribute("aria-current");
      here = item ?? null;
      if (!here) return;
      here.classList.add("here");
      here.setAttribute("aria-current", "true");
      list.scrollTop = here.offsetTop - list.offsetTop - list.clientHeight / 2;
    } });
  };
})();
