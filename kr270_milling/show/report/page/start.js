/* What happens when: at once what is on the first screens, the rest when it is scrolled to; resize. */
(() => {
  const waiting = new Map();
  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting || !waiting.has(entry.target.id)) continue;
      const job = waiting.get(entry.target.id);
      waiting.delete(entry.target.id);
      watcher.unobserve(entry.target);
      job();
    }
  }, { rootMargin: "300px" });
  KR.whenSeen = (id, job) => {
    waiting.set(id, job);
    watcher.observe(KR.by(id));
  };
  /* Pictures that are costly to move are moved only on the screen, and caught up when they come there. */
  const catcher = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) entry.target.catchUp?.();
  }, { rootMargin: "150px" });
  KR.catchUp = (id, mark) => {
    KR.by(id).catchUp = () => mark(KR.place);
    catcher.observe(KR.by(id));
  };
  KR.drawEverything = () => {
    for (const job of waiting.values()) job();
    waiting.clear();
  };

  for (const start of ["Place", "Maps", "Series", "Zoom", "Source", "Part", "Robot", "Charts"]) KR[`start${start}`]();
  KR.place = KR.worst(KR.shownPass());
  KR.remark();
  KR.openAddress();

  let resized = null;
  let wide = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth === wide) return; // a phone's address bar comes and goes
    wide = innerWidth;
    clearTimeout(resized);
    resized = setTimeout(KR.redraw, 150);
  });
  document.documentElement.dataset.ready = "yes";
})();
