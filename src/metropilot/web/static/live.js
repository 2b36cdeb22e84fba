// A live run in the browser: it reads the server's events and draws; the lever goes back the same way.
(() => {
  const KMH = 3.6, KWH = 3.6e6, RENEW_MS = 800, STEP = 0.1;
  const LIMIT = 0, PERMITTED = 1, PLAN = 2, DRIVEN = 3, PROTECTION = 4, HEAD = 5, COMMAND = 6, PLAN_ENERGY = 7, WHEEL = 8, LINE = 9;
  const PLAN_TIME = 12, TIME = 13, TIME_HEAD = 15, ARRIVAL = 16, WISH = 17;
  const BAR = 0.9, ROOM = 1.5, GROW = 1.25, TOP = 0.98;

  const post = (path, body, leaving) => fetch(path, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body), keepalive: leaving,
  });

  // Whose hand is on the lever: this page, for as long as it is open.
  const HOLDER = "tab-" + [...crypto.getRandomValues(new Uint8Array(2))].map((b) => b.toString(16).padStart(2, "0")).join("");

  class View extends MetropilotStream {
    constructor(root, id, chart) {
      super(root, id, chart);
      this.moments = new MetropilotMoments(root, chart);
      this.share = null; this.confirmed = false; this.other = null;
      this.wish = null; this.latest = 0;
      // While a rectangle is dragged nothing is drawn, which would take it from the hand.
      this.onhold = (e) => { this.held = e.type === "pointerdown" && Boolean(e.target.closest(".mp-along .shapelayer")); };
      for (const name of ["pointerdown", "pointerup", "pointercancel"]) document.addEventListener(name, this.onhold, true);
      this.onkey = (e) => this.key(e);
      document.addEventListener("keydown", this.onkey);
      this.onleave = () => { if (this.share !== null && !this.over) this.send({ share: null, holder: HOLDER }, true); };
      window.addEventListener("pagehide", this.onleave);
      this.timer = setInterval(() => this.renew(), RENEW_MS);
    }

    close() {
      this.onleave(); clearInterval(this.timer); super.close(); this.moments.close();
      for (const name of ["pointerdown", "pointerup", "pointercancel"]) document.removeEventListener(name, this.onhold, true);
      document.removeEventListener("keydown", this.onkey); window.removeEventListener("pagehide", this.onleave);
    }

    on_scene(scene) {
      const before = this.now;
      super.on_scene(scene);
      if (before && this.wish === before.scheduled_time_s) this.wish = null;  // it was no wish, but in force
      this.fit();
      this.set("scheduled", scene.scheduled_time_s.toFixed(0), "s");
      const mine = scene.lever !== null && scene.lever.holder === HOLDER;
      this.other = mine ? null : scene.lever;
      if (this.share !== null && !mine && (this.other || this.confirmed)) this.drop(); else this.shown();
      const svg = this.root.querySelector(".mp-strip svg");
      if (svg) this.strip(svg, scene);
      this.draw((Plotly, el) => {
        const end = scene.length_m, limit = scene.limit;
        const xs = [...limit.from_m.map((x) => Math.max(x, 0)), end], ys = limit.limit_mps.map((v) => v * KMH);
        ys.push(ys[ys.length - 1]);
        const plan = scene.plan || { position_m: [], speed_mps: [], time_s: [] }, reference = scene.reference || { position_m: [], energy_wheel_j: [] };
        const top = Math.max(...ys) * 1.1;
        Plotly.restyle(el, { x: [xs, scene.permitted.position_m, plan.position_m, reference.position_m, plan.position_m],
          y: [ys, scene.permitted.speed_mps.map((v) => v * KMH), plan.speed_mps.map((v) => v * KMH), reference.energy_wheel_j.map((j) => j / KWH), plan.time_s],
        }, [LIMIT, PERMITTED, PLAN, PLAN_ENERGY, PLAN_TIME]);
        Plotly.relayout(el, { "xaxis.range": [-0.01 * end, 1.02 * end], "yaxis.range": [0, top],
          shapes: this.shapes(scene, top) });
        this.bars(Plotly, el);
      });
    }

    // The scheduled arrival, and the one of the field, not sent yet, which can be dragged as far as the lane goes;
    // see extend.
    bars(Plotly, el) {
      const { length_m: end, scheduled_time_s: scheduled } = this.now, at = [BAR * end, end];
      const wish = this.over || this.wish === null || this.wish === scheduled ? null : this.wish;
      const words = metropilotSay("scheduled {time} s", { time: +scheduled.toFixed(1) }) + "\u00a0", drawn = wish !== null;
      const hint = drawn ? `${+wish.toFixed(1)} s: ${metropilotSay("not sent yet")}\u00a0` : "", later = drawn && wish > scheduled;
      Plotly.restyle(el, { x: [at, drawn ? at : []], y: [[scheduled, scheduled], drawn ? [wish, wish] : []], text: [[words, ""], [hint, ""]],
        textposition: drawn ? (later ? ["bottom left", "top left"] : ["top left", "bottom left"]) : "middle left" }, [ARRIVAL, WISH]);
      const arrival = { time_s: drawn ? wish : scheduled, from_m: at[0], to_m: at[1], least_s: 1, most_s: Math.floor(this.latest) };
      Plotly.relayout(el, { "yaxis4.range": [0, this.latest], meta: this.over ? {} : { arrival } });
    }

    // Room for what is scheduled, driven and wished: a far time that is taken back leaves none. A lane that is
    // dragged in stays as it is.
    fit() {
      if (handle && handle.held !== null) return;
      const least = ROOM * this.now.scheduled_time_s, last = this.kept[this.kept.length - 1];
      const beyond = [this.wish || 0, last ? last.time_s : 0].filter((s) => s > TOP * least);
      this.latest = Math.max(least, ...beyond.map((s) => GROW * s));
    }

    arrive(time_s) {
      this.wish = time_s;
      if (this.now) this.fit();
      if (this.now && !this.over) this.draw((Plotly, el) => this.bars(Plotly, el));
    }

    // An arrival that was dragged to the top of the lane and let go there makes the lane longer.
    extend(time_s) {
      if (time_s < TOP * this.latest) return;
      this.latest = GROW * time_s;
      this.draw((Plotly, el) => this.bars(Plotly, el));
    }

    // Restrictions in force stay where they are; the one of the fields, not sent yet, can be dragged.
    shapes(scene, top) {
      const box = (from, to, kmh) => ({ type: "rect", xref: "x", yref: "y", x0: from, x1: to, y0: kmh, y1: top, fillcolor: "rgba(213,94,0,.22)", line: { width: 0 } });
      const force = scene.restrictions.map((r) => ({ ...box(r.from_m, r.to_m, r.limit_mps * KMH), layer: "below" }));
      const sent = ([from, to, kmh]) => force.some((box) => box.x0 === from && box.x1 === to && Math.abs(box.y0 - kmh) < 0.05);
      if (!this.draft || this.over || sent(this.draft)) return force;
      const label = { text: metropilotSay("not sent yet"), textposition: "top center", font: { size: 11 } };
      return [...force, { ...box(...this.draft), name: "draft", fillcolor: "rgba(213,94,0,.08)", line: { width: 1.5, color: "#d55e00", dash: "dot" }, label }];
    }

    propose(draft) {
      this.draft = draft;
      if (this.now && !this.over) this.draw((Plotly, el) => Plotly.relayout(el, { shapes: this.shapes(this.now, el.layout.yaxis.range[1]) }));
    }

    strip(svg, scene) {
      const group = svg.querySelector(".mp-restrictions"), x0 = +svg.dataset.x0, scale = +svg.dataset.scale;
      group.replaceChildren(...scene.restrictions.map((r) => {
        const box = document.createElementNS("http://www.w3.org/2000/svg", "rect");
        const values = { x: x0 + scale * r.from_m, width: scale * (Math.min(r.to_m, scene.length_m) - r.from_m), y: +svg.dataset.rail - 4, height: 8, class: "restricted" };
        for (const [name, value] of Object.entries(values)) box.setAttribute(name, value);
        return box;
      }));
    }

    on_end(said) {
      const done = this.outcome === "arrived" ? metropilotSay("arrived at its end")
        : metropilotSay("ended: {outcome}", { outcome: metropilotRetell((this.outcome || "").replaceAll("_", " ")) });
      this.over = true; this.drop();
      super.on_end(said, { done });
      if (this.now) this.draw((Plotly, el) => { Plotly.relayout(el, { shapes: this.shapes(this.now, el.layout.yaxis.range[1]) }); this.bars(Plotly, el); });
      if (this.now) this.moments.offer(this.now, this.kept);
      this.root.dispatchEvent(new CustomEvent("mp-end", { detail: said.status, bubbles: true }));
    }

    on_result(said) { this.outcome = said.kpis.outcome; this.root.dispatchEvent(new CustomEvent("mp-result", { detail: said, bubbles: true })); }

    take(share, over = false) {
      if (this.over) return;
      this.share = Math.round(Math.min(Math.max(share, -1), 1) * 100) / 100;
      this.lever(over);
    }

    drop() { this.share = null; this.confirmed = false; this.shown(); }

    give() { this.share = null; this.confirmed = false; this.lever(); }

    renew() { if (this.share !== null && !this.over) this.lever(); }

    send(body, leaving = false) { return post(`/api/live/${this.id}/lever`, body, leaving); }

    // The lever goes to the server; where somebody else holds it, it says who.
    async lever(over = false) {
      this.shown();
      if (this.over) return;
      const share = this.share, answer = await this.send({ share, holder: HOLDER, take_over: over }).catch(() => null);
      if (answer === null || this.over) return;
      if (answer.ok) { if (share !== null && this.share !== null) this.confirmed = true; return; }
      const held = this.share !== null;
      this.drop();
      if (held) this.say("", metropilotRetell((await answer.json()).error.message));
    }

    shown() {
      const held = this.share !== null, slider = this.part("slider"), other = held || this.over ? null : this.other;
      this.root.dataset.hand = held; this.root.dataset.holder = held ? HOLDER : other ? other.holder : "";
      this.set("hand", held ? metropilotSay("manual: {share} %", { share: (this.share * 100).toFixed(0) })
        : other ? metropilotSay("held by {holder} since {time} s", { holder: other.holder, time: other.since_s.toFixed(1) }) : metropilotSay("the driver has it"));
      if (slider) { slider.value = held ? this.share : 0; slider.disabled = !held; }
      const button = this.part("take");
      if (button) { button.textContent = metropilotSay(held ? "Give the lever back (Esc)" : other ? "Take the lever over" : "Take the lever (M)"); button.title = metropilotSay("this page is {holder}", { holder: HOLDER }); }
    }

    key(e) {
      if (this.over || e.ctrlKey || e.metaKey || e.altKey) return;
      const typing = e.target.closest && e.target.closest("input:not([type=range]), textarea, [role=listbox], [role=combobox]");
      if (typing) return;
      const pressed = e.target.closest && e.target.closest("button, a, input, [role=button], [role=slider], [tabindex='0']");
      if (e.key === " " && !pressed && !e.repeat) { this.part("pause").click(); e.preventDefault(); return; }
      const held = this.share !== null;
      const does = { m: () => !held && !this.other && this.take(0), ArrowUp: () => held && this.take(this.share + STEP), ArrowDown: () => held && this.take(this.share - STEP),
        0: () => held && this.take(0), b: () => held && this.take(-1), Escape: () => held && this.give() }[e.key];
      if (does && does() !== false) e.preventDefault();
    }

    // Drawn ten times a second at most.
    on_rows(said) {
      super.on_rows(said, 90);
      const pause = this.part("pause"), paused = said.pace === 0;
      if (pause.dataset.paused !== String(paused)) {
        pause.dataset.paused = paused;
        pause.textContent = metropilotSay(paused ? "Go on (space)" : "Pause (space)");
      }
    }

    update(last) {
      if (!this.now) return;
      this.moments.show(this.now, last, this.kept[this.kept.length - 2]);
      const slider = this.part("slider");
      if (slider && this.share === null) slider.value = last.wanted;
      if (this.held) return;
      this.draw((Plotly, el) => {
        const fresh = this.kept.slice(this.drawn);
        this.drawn = this.kept.length;
        const xs = fresh.map((r) => r.position_m);
        const hit = fresh.filter((r, k) => r.level && !((k ? fresh[k - 1] : this.before) || {}).level);
        this.before = fresh[fresh.length - 1] || this.before;
        if (fresh.length) Plotly.extendTraces(el, {
          x: [xs, xs, xs, xs, xs, hit.map((r) => r.position_m)],
          y: [fresh.map((r) => r.speed_mps * KMH), fresh.map((r) => r.command), fresh.map((r) => r.energy_wheel_j / KWH), fresh.map((r) => r.energy_line_j / KWH), fresh.map((r) => r.time_s), hit.map((r) => r.speed_mps * KMH)],
        }, [DRIVEN, COMMAND, WHEEL, LINE, TIME, PROTECTION]);
        Plotly.restyle(el, { x: [[last.position_m], [last.position_m]], y: [[last.speed_mps * KMH], [last.time_s]] }, [HEAD, TIME_HEAD]);
        if (last.time_s > this.latest) { this.latest = GROW * last.time_s; this.bars(Plotly, el); }
      });
    }
  }

  let view = null, past = null, handle = null;
  window.metropilot = {
    // The moments of a run that was over before the page was opened.
    past(rootId, chart, scene) {
      const rows = scene.rows.map((values) => Object.fromEntries(scene.columns.map((name, k) => [name, values[k]])));
      past = new MetropilotMoments(document.getElementById(rootId), chart);
      past.set("scheduled", scene.scheduled_time_s.toFixed(0), "s");
      past.offer(scene, rows);
    },
    // Another picture takes the place of the run's.
    forget() { for (const moments of [past, view && view.over && view.moments]) if (moments) moments.close(); past = null; },
    live(rootId, id, chart) {
      if (view) view.close();
      this.forget();
      const root = document.getElementById(rootId);
      root.dataset.run = id; root.dataset.status = "running"; root.dataset.position = 0; root.dataset.time = 0;
      const list = root.querySelector('[data-mp="log"]');
      if (list) list.replaceChildren();
      view = new View(root, id, chart);
      view.draw((Plotly, el) => Plotly.restyle(el, { x: el.data.map(() => []), y: el.data.map(() => []) }));
      history.replaceState(null, "", `/?run=${id}`);
      view.set("status", metropilotSay("under way"));
      view.shown();
    },
    arrive(time_s) { if (view && !view.over) view.arrive(time_s); },
    release(time_s) { if (view && !view.over) view.extend(time_s); },
    arrival(rootId, chart) {
      if (!handle) handle = new MetropilotArrival(document.getElementById(rootId), chart);
      handle.place();
    },
    draft(place) { if (view && !view.over) view.propose(place); },
    drag(rootId, chart, changes) {
      const place = metropilotDragged(document.getElementById("c" + chart), changes || {});
      if (place) document.getElementById(rootId).dispatchEvent(new CustomEvent("mp-restriction", { detail: place }));
    },
    hand() { if (view) view.share === null ? view.take(0, view.other !== null) : view.give(); },
    slide(value) { if (view && view.share !== null) view.take(+value); },
  };
})();
