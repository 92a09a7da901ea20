"use strict";
(() => {
  // CSS pixels: below this a legend stands under its chart; the width of a chart on paper; a line and a letter of a legend.
  const NARROW = 720, PAPER = 960, LINE = 20, LETTER = 6.5;
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

  // What is filtered out is not drawn; of a group whose entry in the legend goes with it, the next one gets the entry.
  function traces(plot) {
    const all = figureOf(plot).data, named = new Set();
    const grouped = new Set(all.filter((trace) => trace.legendgroup && trace.showlegend !== false).map((trace) => trace.legendgroup));
    return all.map((trace) => {
      if (isOff(trace.meta)) return { ...trace, visible: false };
      if (!grouped.has(trace.legendgroup)) return trace;
      const first = !named.has(trace.legendgroup);
      named.add(trace.legendgroup);
      return { ...trace, showlegend: first };
    });
  }

  function layout(plot, width) {
    const given = figureOf(plot).layout ?? {}, clear = "rgba(0,0,0,0)";
    const made = { ...given, width, paper_bgcolor: clear, plot_bgcolor: clear, hoverlabel: { align: "left", namelength: -1, ...given.hoverlabel } };
    made.font = { family: "system-ui, sans-serif", size: 13, ...given.font };
    made.margin = { t: 40, b: 60, l: 80, r: 20, ...given.margin };
    const named = given.showlegend === false ? [] : figureOf(plot).data.filter((trace) => trace.showlegend !== false && trace.name);
    // A legend that is cut off cannot be read on paper.
    if (given.legend?.orientation === "h") {
      made.height = (given.height ?? 480) + (linesOf(named, width) - linesOf(named, PAPER)) * LINE;
      return made;
    }
    made.height = Math.max(given.height ?? 480, named.length * LINE + 130);
    if (width < NARROW && named.length && !plot.classList.contains("panels")) legendBelow(made, named, width);
    return made;
  }

  // Of a legend that lies across the chart.
  function linesOf(named, width) {
    if (!named.length) return 0;
    const longest = Math.max(...named.map((trace) => trace.name.length));
    return Math.ceil(named.length / Math.max(Math.floor((width - 80) / (longest * LETTER + 50)), 1));
  }

  function legendBelow(made, named, width) {
    const longest = Math.max(...named.map((trace) => trace.name.length));
    const columns = longest * LETTER + 50 < width / 2 ? 2 : 1;
    const below = Math.ceil(named.length / columns) * LINE + 20, height = 320, left = 64;
    made.margin = { ...made.margin, l: left, r: 12, b: 70 + below };
    made.height = made.margin.t + height + made.margin.b;
    made.legend = {
      ...made.legend, orientation: columns > 1 ? "h" : "v", x: -left / (width - left - 12), xanchor: "left", y: -70 / height, yanchor: "top",
      entrywidth: columns > 1 ? 0.5 : undefined, entrywidthmode: "fraction", maxheight: below + 40, font: { size: 11 },
    };
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
  if (form) {
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
  }

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
