// A plot as SVG or PNG, or its values as CSV with titles and units of its axes.
(() => {
  const plain = (title) => String((title && (title.text ?? title)) || "").replace(/<[^>]*>/g, " ").trim();
  const quoted = (value) => { const text = value === null || value === undefined ? "" : String(value); return /[",\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text; };

  // Two columns a curve, with what is hidden by the legend left out.
  const table = (el) => {
    const columns = [];
    for (const trace of el.data) {
      if (trace.visible === false || trace.visible === "legendonly" || !trace.x || !trace.x.length) continue;
      if (!trace.name && trace.hoverinfo === "skip") continue;
      for (const way of ["x", "y"]) {
        const name = (trace[way + "axis"] || way).replace(way, way + "axis"), title = plain((el.layout[name] || {}).title);
        columns.push([[trace.name, title].filter(Boolean).join(": "), ...Array.from(trace[way])]);
      }
    }
    const rows = Math.max(0, ...columns.map((column) => column.length));
    return Array.from({ length: rows }, (_, k) => columns.map((column) => quoted(column[k])).join(",")).join("\n") + "\n";
  };

  const save = (address, name) => {
    const link = document.createElement("a");
    Object.assign(link, { href: address, download: name });
    link.click();
  };

  document.addEventListener("click", async (e) => {
    const button = e.target.closest("[data-copy]");
    if (!button) return;
    const el = document.getElementById("c" + button.dataset.plot), { Plotly } = getElement(+button.dataset.plot), format = button.dataset.copy;
    const page = location.pathname.slice(1) || "drive", number = [...document.querySelectorAll(".js-plotly-plot")].indexOf(el) + 1;
    const name = `metropilot-${page}-${number}.${format}`;
    if (format === "csv") {
      const address = URL.createObjectURL(new Blob(["\ufeff", table(el)], { type: "text/csv" }));
      save(address, name);
      setTimeout(() => URL.revokeObjectURL(address), 1000);
      return;
    }
    const white = { paper_bgcolor: "#fff", plot_bgcolor: "#fff", font: { ...el.layout.font, color: "#1c2530" } };
    const figure = { data: el.data, layout: { ...el.layout, ...white } };
    save(await Plotly.toImage(figure, { format, width: el.clientWidth, height: el.clientHeight, scale: format === "png" ? 2 : 1 }), name);
  });
})();
