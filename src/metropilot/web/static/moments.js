// One moment of a run: its numbers, the trainset on the strip, a cursor on every plot over distance.
(() => {
  const KMH = 3.6, KWH = 3.6e6, HEAD = 5, TIME_HEAD = 15, CURSOR = "moment", ROW = "restriction-", DRAFT = "draft";
  const GRID_M = 10, GRID_KMH = 5;


  // A rectangle that was dragged, as a restriction for the fields; null for a change of anything else.
  window.metropilotDragged = (el, changes) => {
    const key = Object.keys(changes).find((name) => /^shapes\[\d+\]\.[xy][01]$/.test(name));
    const shape = key && el.layout.shapes[+key.match(/\d+/)[0]], name = (shape && shape.name) || "";
    if (name !== DRAFT && !name.startsWith(ROW)) return null;
    const from_m = Math.max(MetropilotPicture.snap(Math.min(shape.x0, shape.x1), GRID_M), 0);
    return {
      row: name === DRAFT ? null : +name.slice(ROW.length), from_m,
      to_m: Math.max(MetropilotPicture.snap(Math.max(shape.x0, shape.x1), GRID_M), from_m + GRID_M),
      limit_mps: Math.max(MetropilotPicture.snap(Math.min(shape.y0, shape.y1), GRID_KMH), GRID_KMH),
    };
  };

  window.MetropilotMoments = class extends MetropilotPicture {
    constructor(root, chart) { super(root, chart); this.rows = []; this.shown = null; }

    // Numbers and trainset at a row; the one before it gives the power.
    show(scene, row, before) {
      const left = scene.length_m - row.position_m, best = row.plan_energy_wheel_j, told = this.words(scene, row, before);
      this.root.dataset.time = row.time_s; this.root.dataset.position = row.position_m;
      this.set("speed", told.speed, "km/h");
      this.set("permitted", told.permitted, "km/h");
      this.set("distance", left.toFixed(Math.abs(left) < 20 ? 2 : 0), "m");
      this.set("time", told.time, "s");
      this.set("command", told.share, told.way);
      if (before) this.set("power", told.power, "kW");
      this.set("energy", told.energy, "kWh");
      this.set("against", best > 36000 ? `${((row.energy_wheel_j / best - 1) * 100).toFixed(1)}` : "–", "%");
      this.set("level", told.level);
      this.part("level").className = row.level ? "v mp-fail" : "v";
      const train = this.root.querySelector(".mp-train"), svg = train && train.closest("svg");
      if (train) {
        const along = +svg.dataset.scale * row.position_m;
        train.style.transform = `translateX(${along.toFixed(2)}px)`;
        this.follow(svg, along);
      }
      return told;
    }

    words(scene, row, before) {
      const coast = Math.abs(row.command) < 0.005;
      const watts = before ? (row.energy_line_j - before.energy_line_j) / (row.time_s - before.time_s || 1) : 0;
      return {
        time: row.time_s.toFixed(1), position: row.position_m.toFixed(0), speed: (row.speed_mps * KMH).toFixed(1),
        permitted: (row.permitted_mps * KMH).toFixed(1), power: (watts / 1000).toFixed(0), energy: (row.energy_wheel_j / KWH).toFixed(2),
        share: coast ? metropilotSay("coast") : `${Math.abs(row.command * 100).toFixed(0)}`,
        way: coast ? "" : metropilotSay(row.command > 0 ? "% power" : "% brake"),
        level: row.level ? metropilotRetell(scene.levels[row.level]) : metropilotSay("watching"),
      };
    }

    // Offer the moments of a run that is over; the last one is shown first.
    offer(scene, rows) {
      if (!rows.length) return;
      Object.assign(this, { scene, rows });
      const slider = this.part("moment");
      slider.max = rows.length - 1; slider.value = slider.max;
      this.part("moments").hidden = false;
      slider.oninput = () => this.go(+slider.value);
      this.onmove = (e) => this.point(e);
      document.addEventListener("pointermove", this.onmove);
      this.go(rows.length - 1);
    }

    close() {
      document.removeEventListener("pointermove", this.onmove);
      this.part("moments").hidden = true;
      if (this.rows.length) this.draw((Plotly) => this.mark(Plotly, null));
      this.rows = []; this.asked = null;
    }

    // The pointer over a plot over distance, or over the strip, chooses the moment there.
    point(e) {
      if (e.buttons || !e.target.closest) return;
      const plot = e.target.closest(".mp-along"), svg = e.target.closest(".mp-strip svg");
      let at = null;
      if (plot && plot._fullLayout && plot._fullLayout.xaxis) {
        const axis = plot._fullLayout.xaxis, x = e.clientX - plot.getBoundingClientRect().left - axis._offset;
        if (x >= 0 && x <= axis._length) at = axis.p2d(x);
      } else if (svg && this.root.contains(svg)) {
        const box = svg.getBoundingClientRect();
        at = (((e.clientX - box.left) / box.width) * 1000 - +svg.dataset.x0) / +svg.dataset.scale;
      }
      if (at !== null) this.go(this.nearest(at));
    }

    nearest(position_m) {
      let low = 0, high = this.rows.length - 1;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (this.rows[middle].position_m < position_m) low = middle + 1; else high = middle;
      }
      return low && position_m - this.rows[low - 1].position_m < this.rows[low].position_m - position_m ? low - 1 : low;
    }

    // As often as the browser draws.
    go(k) {
      const waits = this.asked !== null && this.asked !== undefined;
      this.asked = k;
      if (!waits) requestAnimationFrame(() => { const now = this.asked; this.asked = null; if (now !== null && this.rows[now]) this.put(now); });
    }

    put(k) {
      const row = this.rows[k], slider = this.part("moment"), told = this.show(this.scene, row, this.rows[k - 1]);
      if (+slider.value !== k) slider.value = k;
      this.set("place", `${told.time} s · ${told.position} m`);
      slider.setAttribute("aria-valuetext", metropilotSay(
        "{time} s, {position} m, {speed} km/h, permitted {permitted} km/h, {command}, {power} kW, {energy} kWh, protection: {level}",
        { ...told, command: `${told.share} ${told.way}`.trim() }));
      this.draw((Plotly) => this.mark(Plotly, row));
    }

    // A cursor on each plot over distance, and the trainset's point on the curve of its speed.
    mark(Plotly, row) {
      for (const el of document.querySelectorAll(".mp-along.js-plotly-plot")) {
        if (!el.layout) continue;
        const shapes = (el.layout.shapes || []).filter((shape) => shape.name !== CURSOR);
        if (row) shapes.push({ type: "line", name: CURSOR, layer: "below", xref: "x", yref: "paper", x0: row.position_m, x1: row.position_m, y0: 0, y1: 1, line: { color: "#7a8793", width: 1.5 } });
        if (row && el.id === "c" + this.chart) Plotly.update(el, { x: [[row.position_m], [row.position_m]], y: [[row.speed_mps * KMH], [row.time_s]] }, { shapes }, [HEAD, TIME_HEAD]);
        else Plotly.relayout(el, { shapes });
      }
    }
  };
})();
