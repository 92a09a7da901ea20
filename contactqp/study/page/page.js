"use strict";
(() => {
  // CSS pixels: below this a legend stands under its chart; and the width of a chart on paper.
  const NARROW = 720, PAPER = 960;
  const CONFIG = { responsive: false, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  const hidden = { method: new Set(), variant: new Set(), verdict: new Set() };
  const all = (selector, from = document) => [...from.querySelectorAll(selector)];
  const byId = (id) => document.getElementById(id);
  const cases = all(".case"), plots = all(".plot");
  const figures = new Map();
  document.documentElement.classList.add("scripted");

  // Whether something with these values of the facets is filtered out.
  const isOff = (values) => Object.entries(hidden).some(([facet, off]) => off.has(values?.[facet]));

  function figureOf(plot) {
    if (!figures.has(plot)) figures.set(plot, JSON.parse(byId(plot.dataset.figure).textContent));
    return figures.get(plot);
  }

  function traces(plot) {
    return figureOf(plot).data.map((trace) => (isOff(trace.meta) ? { ...trace, visible: false } : trace));
  }

  function layout(plot, width) {
    const given = figureOf(plot).layout ?? {}, clear = "rgba(0,0,0,0)";
    const made = { ...given, width, paper_bgcolor: clear, plot_bgcolor: clear, hoverlabel: { align: "left", namelength: -1, ...given.hoverlabel } };
    made.font = { family: "system-ui, sans-serif", size: 13, ...given.font };
    made.height = given.height ?? 480;
    if (width < NARROW && !plot.classList.contains("panels")) {
      const named = figureOf(plot).data.filter((trace) => trace.showlegend !== false && trace.name).length;
      const lines = given.showlegend === false ? 0 : Math.ceil(named / 2);
      made.legend = { ...given.legend, orientation: "h", x: 0, xanchor: "left", y: -0.24, yanchor: "top", font: { size: 11 } };
      made.height = 400 + 21 * lines;
      made.margin = { ...given.margin, l: 64, r: 12, b: 60 + 21 * lines };
    }
    return made;
  }

  const widthOf = (plot) => Math.max(plot.clientWidth, 280);

  function draw(plot, width = widthOf(plot)) {
    if ("xaxis2" in (figureOf(plot).layout ?? {})) plot.classList.add("panels");
    plot.dataset.drawn = width;
    return Plotly.react(plot, traces(plot), layout(plot, width), CONFIG);
  }

  const redraw = (width) => plots.filter((plot) => plot.dataset.drawn).forEach((plot) => draw(plot, width));

  // Charts are drawn when they come near the window; those in a closed case have no place in it.
  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (entry.isIntersecting) {
        watcher.unobserve(entry.target);
        draw(entry.target);
      }
    }
  }, { rootMargin: "400px" });
  plots.forEach((plot) => watcher.observe(plot));

  let waiting;
  addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => plots.filter((plot) => plot.dataset.drawn && plot.clientWidth && Number(plot.dataset.drawn) !== widthOf(plot)).forEach((plot) => draw(plot)), 150);
  });

  // Filters.
  const texts = new Map(cases.map((one) => [one, all("[data-searched]", one).map((part) => part.textContent).join(" ").toLowerCase()]));
  const rowsOf = new Map(cases.map((one) => [one, all(".rows tbody tr", one)]));
  const lines = all("tr[data-method]");

  function filter() {
    const words = byId("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const facet of Object.keys(hidden)) {
      hidden[facet] = new Set(all(`input[name="${facet}"]:not(:checked)`).map((box) => box.value));
    }
    for (const line of lines) line.hidden = isOff(line.dataset);
    let count = 0;
    for (const one of cases) {
      const rows = rowsOf.get(one);
      one.hidden = !words.every((word) => texts.get(one).includes(word)) || (rows.length > 0 && rows.every((row) => row.hidden));
      const entry = document.querySelector(`[data-case="${CSS.escape(one.id)}"]`);
      if (entry) entry.hidden = one.hidden;
      count += !one.hidden;
    }
    byId("none").hidden = count > 0;
    byId("shown").textContent = `${count} of ${cases.length} cases shown`;
    plots.filter((plot) => plot.dataset.drawn).forEach((plot) => draw(plot, Number(plot.dataset.drawn)));
  }

  const form = byId("choices");
  form.addEventListener("input", filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(filter));
  for (const button of all("button[data-all]")) {
    button.addEventListener("click", () => {
      for (const box of all("input", button.closest("fieldset"))) box.checked = Boolean(button.dataset.all);
      filter();
    });
  }
  const openAll = (open) => cases.forEach((one) => { one.open = open; });
  byId("open-all").addEventListener("click", () => openAll(true));
  byId("close-all").addEventListener("click", () => openAll(false));

  // A link to a case opens it.
  function openTarget() {
    const target = byId(decodeURIComponent(location.hash.slice(1)));
    if (target instanceof HTMLDetailsElement) {
      target.open = true;
      target.scrollIntoView();
      target.querySelector("summary").focus({ preventScroll: true });
    }
  }
  addEventListener("hashchange", openTarget);
  openTarget();

  // On paper everything is open and drawn.
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = all("details:not([open]):not(.numbers)");
    opened.forEach((one) => { one.open = true; });
    plots.forEach((plot) => draw(plot, PAPER));
  });
  addEventListener("afterprint", () => {
    opened.forEach((one) => { one.open = false; });
    redraw();
  });
})();
