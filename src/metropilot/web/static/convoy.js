// A live convoy in the browser: trainsets on the track, gaps and speed differences over time.
(() => {
  const KMH = 3.6;

  class Convoy extends MetropilotStream {
    on_scene(scene) {
      const first = !this.now;
      super.on_scene(scene);
      this.root.dataset.silent = scene.link.silent;
      this.set("link", scene.link.silent ? metropilotSay("silent")
        : metropilotSay("{delay} s, {loss} % lost", { delay: scene.link.delay_s, loss: Math.round(scene.link.loss * 100) }));
      this.part("link").className = scene.link.silent ? "v mp-fail" : "v";
      if (first) this.place(scene);
    }

    // One rectangle a trainset, to scale; the browser moves them.
    place(scene) {
      const svg = this.root.querySelector(".mp-strip svg"), group = svg && svg.querySelector(".mp-convoy");
      if (!group) return;
      const scale = +svg.dataset.scale, x0 = +svg.dataset.x0, length = Math.max(scale * scene.trainset_length_m, 8);
      group.replaceChildren(...scene.starts_m.map(() => {
        const box = document.createElementNS("http://www.w3.org/2000/svg", "rect");
        const values = { x: x0 - length, y: +svg.dataset.rail - 13, width: length, height: 9, rx: 3, class: "train mp-train" };
        for (const [name, value] of Object.entries(values)) box.setAttribute(name, value);
        return box;
      }));
    }

    on_rows(said) { super.on_rows(said, 120); }

    update(last) {
      const scene = this.now;
      this.root.dataset.time = last.time_s; this.root.dataset.gap = Math.min(...last.gap_m);
      this.set("time", last.time_s.toFixed(1), "s");
      this.set("speed", (last.speed_mps[0] * KMH).toFixed(1), "km/h");
      this.set("gap", Math.min(...last.gap_m).toFixed(2), "m");
      this.set("least", Math.min(...this.kept.map((r) => Math.min(...r.gap_m))).toFixed(2), "m");
      const apart = last.apart_mps.reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a), 0);
      this.set("apart", (apart * KMH).toFixed(2), "km/h");
      this.set("age", Math.max(...last.age_s).toFixed(1), "s");
      const worst = Math.max(...last.level);
      this.set("level", worst ? metropilotRetell(scene.levels[worst]) : metropilotSay("watching"));
      this.part("level").className = worst ? "v mp-fail" : "v";
      const svg = this.root.querySelector(".mp-strip svg"), boxes = svg ? svg.querySelectorAll(".mp-convoy rect") : [];
      boxes.forEach((box, k) => { box.style.transform = `translateX(${(+svg.dataset.scale * last.position_m[k]).toFixed(2)}px)`; });
      if (svg) this.follow(svg, +svg.dataset.scale * last.position_m[0]);
      this.draw((Plotly, el) => {
        const fresh = this.kept.slice(this.drawn), pairs = last.gap_m.length, xs = fresh.map((r) => r.time_s);
        this.drawn = this.kept.length;
        if (!fresh.length) return;
        const traces = [], ys = [];
        for (let k = 0; k < pairs; k++) {
          traces.push(k, 6 + k); ys.push(fresh.map((r) => r.gap_m[k]), fresh.map((r) => r.apart_mps[k] * KMH));
        }
        for (let k = 0; k <= pairs; k++) { traces.push(12 + k); ys.push(fresh.map((r) => r.speed_mps[k] * KMH)); }
        Plotly.extendTraces(el, { x: traces.map(() => xs), y: ys }, traces);
      });
    }

    on_result(said) { this.root.dispatchEvent(new CustomEvent("mp-result", { detail: said.success, bubbles: true })); }

    on_end(said) { super.on_end(said, { done: metropilotSay("all stopped"), stopped: metropilotRetell("stopped") }); }
  }

  let view = null;
  window.metropilotConvoy = (rootId, id, chart, pairs) => {
    if (view) view.close();
    const root = document.getElementById(rootId);
    Object.assign(root.dataset, { run: id, status: "running", time: 0 });
    root.querySelector('[data-mp="log"]').replaceChildren();
    view = new Convoy(root, id, chart);
    view.draw((Plotly, el) => Plotly.restyle(el, { x: el.data.map(() => []), y: el.data.map(() => []),
      showlegend: el.data.map((t, k) => k >= 12 && k <= 12 + pairs) }));
    history.replaceState(null, "", `/convoy?run=${id}`);
    view.set("status", metropilotSay("under way"));
  };
})();
