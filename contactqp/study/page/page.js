"use strict";
(() => {
  // CSS pixels: below these a legend stands under its chart, and in place of the names at the points; width and height
  // of a chart on paper; a line and a letter of a legend.
  const NARROW = 720, NO_NAMES = 500, PAPER = 960, PAPER_HEIGHT = 530, LINE = 20, LETTER = 6.5;
  const LINES = "tbody tr:not(.note-of-row)";  // without what stands below one
  const CONFIG = { responsive: false, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  const hidden = { method: new Set(), variant: new Set(), verdict: new Set() };
  const all = (selector, from = document) => [...from.querySelectorAll(selector)];
  const byId = (id) => document.getElementById(id);
  const cases = all(".case"), plots = all(".plot");
  let figures = {};
  document.documentElement.classList.add("scripted");

  // Whether something with these values of the facets is filtered out.
  const isOff = (values) => Object.entries(hidden).some(([facet, off]) => off.has(values?.[facet]));

  const isName = (note) => note.name === "method";
  const figureOf = (plot) => figures[plot.dataset.figure];

  async function unpacked(id) {
    const bytes = Uint8Array.from(atob(byId(id).textContent), (letter) => letter.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }

  // What is filtered out is not drawn; of a group whose entry in the legend goes with it, the next one gets the entry.
  function traces(plot, width) {
    const all = figureOf(plot).data.map((trace) => ({ ...trace, name: trace.name && fitted(trace.name, width - 90) })), named = new Set();
    const grouped = new Set(all.filter((trace) => trace.legendgroup && trace.showlegend !== false).map((trace) => trace.legendgroup));
    return all.map((given) => {
      const trace = given.type === "bar" ? { cliponaxis: false, ...given } : given;  // texts beside the longest bars
      if (isOff(trace.meta)) return { ...trace, visible: false };
      if (!grouped.has(trace.legendgroup)) return trace;
      const first = !named.has(trace.legendgroup);
      named.add(trace.legendgroup);
      return { ...trace, showlegend: first };
    });
  }

  // The layout as it is given; of a chart too narrow for the names at its points, with a legend in their place.
  function givenFor(plot, width) {
    const given = figureOf(plot).layout ?? {};
    if (width >= NO_NAMES || !given.annotations?.some(isName)) return given;
    return { ...given, showlegend: true, annotations: given.annotations.filter((note) => !isName(note)) };
  }

  function layout(plot, width) {
    const given = givenFor(plot, width), clear = "rgba(0,0,0,0)";
    const made = { ...given, width, paper_bgcolor: clear, plot_bgcolor: clear, hoverlabel: { align: "left", namelength: -1, ...given.hoverlabel } };
    made.font = { family: "system-ui, sans-serif", size: 13, ...given.font };
    made.margin = { t: 40, b: 60, l: 80, r: 20, ...given.margin };
    if (width < NARROW) shrink(made, width);
    const named = given.showlegend === false ? [] : figureOf(plot).data.filter((trace) => trace.showlegend !== false && trace.name);
    // A legend that is cut off cannot be read on paper.
    if (given.legend?.orientation === "h") {
      made.height = (given.height ?? 480) + (linesOf(named, width) - linesOf(named, PAPER)) * LINE;
      if (width === PAPER) made.height = Math.min(made.height, PAPER_HEIGHT);
      return made;
    }
    made.height = Math.max(given.height ?? 480, named.length * LINE + 130);
    if (width < NARROW && named.length && !plot.classList.contains("panels")) legendBelow(made, named, width);
    return made;
  }

  // Smaller letters, titles of axes on several lines, and logarithmic axes with their decades alone.
  function shrink(made, width) {
    made.font = { ...made.font, size: 11 };
    for (const name of ["xaxis", "yaxis"].filter((name) => made[name])) {
      const axis = { ...made[name] }, [low, high] = axis.range ?? [0, 0];
      const most = Math.floor((name === "xaxis" ? width - 120 : 300) / LETTER);
      if (axis.title?.text) axis.title = { ...axis.title, text: wrapped(axis.title.text, most), font: { size: 12 } };
      if (name === "xaxis" && axis.type === "log" && high - low > 2) axis.dtick = Math.ceil((high - low) / 5);
      made[name] = axis;
    }
    const left = made.yaxis?.automargin || made.yaxis?.type === "category" ? -0.6 : -0.15;  // below the names of its ticks
    for (const name of ["legend", "legend2"].filter((name) => made[name])) made[name] = { ...made[name], x: left, font: { size: 10 } };
    made.margin = { ...made.margin, r: Math.max(made.margin.r, 34) };
    made.annotations = made.annotations?.map((note) => (isName(note) ? note : { ...note, text: fitted(note.text, width / 2), font: { size: 9 } }));
  }

  // Texts that are longer than a narrow chart is wide, on several lines.
  const fitted = (text, room) => (room < NO_NAMES ? wrapped(text, Math.max(Math.floor(room / LETTER), 20)) : text);

  function wrapped(text, most) {
    let line = "", lines = [];
    for (const word of text.split(" ")) {
      if (line && line.length + word.length >= most) lines.push(line), line = "";
      line += (line && " ") + word;
    }
    return [...lines, line].join("<br>");
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

  function draw(plot, asked) {
    const { data, layout: given } = figureOf(plot);
    if ("xaxis2" in (given ?? {}) || data.some((trace) => trace.type === "heatmap")) plot.classList.add("panels");
    plot.style.minHeight = 0;
    const width = asked ?? widthOf(plot);  // now that what is wide may scroll
    // Of another width it is drawn anew: Plotly keeps margins that it once gave to a legend.
    const again = Number(plot.dataset.drawn) === width;
    plot.dataset.drawn = width;
    const config = { ...CONFIG, displayModeBar: width < NARROW ? false : "hover" };
    return (again ? Plotly.react : Plotly.newPlot)(plot, traces(plot, width), layout(plot, width), config);
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

  async function start() {
    if (typeof DecompressionStream === "undefined") {
      byId("too-old").hidden = false;
      return;
    }
    const [library, text] = await Promise.all(["plotly", "figures"].map(unpacked));
    const script = document.createElement("script");
    script.textContent = library;
    document.head.append(script);
    figures = JSON.parse(text);
    plots.forEach((plot) => watcher.observe(plot));
  }
  start();

  let waiting;
  addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => plots.filter((plot) => plot.dataset.drawn && plot.clientWidth && Number(plot.dataset.drawn) !== widthOf(plot)).forEach((plot) => draw(plot)), 150);
  });

  // Filters.
  const texts = new Map(cases.map((one) => [one, all("[data-searched]", one).map((part) => part.textContent).join(" ").toLowerCase()]));
  const rowsOf = new Map(cases.map((one) => [one, all(`.rows ${LINES}`, one)]));
  const lines = [];
  for (const table of all("table:has(th[data-facet])")) {
    const facets = all("thead th", table).map((heading) => heading.dataset.facet);
    for (const line of all(LINES, table)) {
      lines.push(line);
      // A verdict has its sign in front.
      facets.forEach((facet, i) => { if (facet) line.dataset[facet] = line.cells[i].textContent.replace(/^[^\p{L}\p{N}]+/u, ""); });
    }
  }

  function filter() {
    const words = byId("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const facet of Object.keys(hidden)) {
      hidden[facet] = new Set(all(`input[name="${facet}"]:not(:checked)`).map((box) => box.value));
    }
    for (const line of lines) {
      line.hidden = isOff(line.dataset);
      const below = line.nextElementSibling;
      if (below?.matches(".note-of-row")) below.hidden = line.hidden;
    }
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

  function setUpFilters(form) {
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
  if (byId("choices")) setUpFilters(byId("choices"));

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
    if (window.Plotly) plots.forEach((plot) => draw(plot, PAPER));
  });
  addEventListener("afterprint", () => {
    opened.forEach((one) => { one.open = false; });
    redraw();
  });
})();
