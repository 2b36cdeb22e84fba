// The handle on the bar of the arrival, in the lane of time of a run: dragged up and down, in whole seconds.
(() => {
  const LEAST_PX = 44;

  window.MetropilotArrival = class extends MetropilotPicture {
    constructor(root, chart) {
      super(root, chart);
      this.held = null;
      this.bar = this.handle("mp-arrival", (e) => this.take(e));
      this.bar.append(document.createElement("span"));
    }

    // At its bar wherever the picture is drawn anew; hidden where the picture's arrival cannot be dragged.
    place() {
      const el = document.getElementById("c" + this.chart), full = el && el._fullLayout;
      if (!full || !full.yaxis4 || !full.yaxis4._length) return;
      if (this.bar.parentElement !== el) el.append(this.bar);
      const told = (el.layout.meta || {}).arrival, { xaxis, yaxis4 } = full;
      Object.assign(this, { told, axis: yaxis4 });
      if (!told) { this.held = null; this.bar.hidden = true; return; }
      const left = xaxis.d2p(told.from_m), right = xaxis.d2p(told.to_m), width = Math.max(right - left, LEAST_PX);
      const top = yaxis4.d2p(told.time_s);
      this.bar.hidden = this.held === null && (right < 0 || right > xaxis._length + 1 || top < 0 || top > yaxis4._length);
      this.bar.style.left = `${xaxis._offset + right - width}px`; this.bar.style.width = `${width}px`;
      this.at(this.held === null ? told.time_s : this.held);
    }

    at(time_s) { this.bar.style.top = `${this.axis._offset + this.axis.d2p(time_s)}px`; }

    take(e) {
      this.held = this.sent = this.told.time_s;
      this.offset = e.clientY - this.axis.d2p(this.held);
    }

    move(e) {
      if (this.held === null) return;
      const top = Math.floor(Math.max(...this.axis.range)), { least_s, most_s } = this.told;
      this.held = Math.min(Math.max(Math.round(this.axis.p2d(e.clientY - this.offset)), least_s), most_s, top);
      this.bar.dataset.time = `${this.held} s`;
      this.at(this.held);
      this.soon(() => this.send());
    }

    leave() {
      if (this.held === null) return;
      this.send();
      const last = this.held;
      this.held = null;
      delete this.bar.dataset.time;
      metropilot.release(last);
    }

    send() {
      if (this.held === null || this.held === this.sent) return;
      this.sent = this.held;
      this.root.dispatchEvent(new CustomEvent("mp-arrival", { detail: this.held, bubbles: true }));
    }
  };
})();
