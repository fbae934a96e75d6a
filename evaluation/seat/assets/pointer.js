"use strict";
// From a mouse, a finger or keys to where the hand should be, or how the head should turn.

const REACH = 0.75; // m from the shoulder's start, beyond which no hand is asked for
const KEY_SPEED = 0.35; // m/s of a hand that keys move
const TURN_SPEED = 1.2; // rad/s of a head that keys turn
const HEAD = { yaw: 0.7, pitch: 0.45, lean: 0.35, jaw: 0.5 }; // rad, the most that is asked for
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

// What a visitor points at. `sample(seconds)` returns the module's pointer.
class Pointer {
  constructor(seat, stage) {
    this.seat = seat;
    this.keys = new Set();
    this.used = "mouse";
    this.at = null; // on the picture, from -1 to 1 to the right and up
    this.hand = [0, 0, 0];
    this.held = 1;
    this.head = { yaw: 0, pitch: 0, lean: 0, jaw: 0 };
    this.pressed = false;
    const place = (event) => {
      const box = stage.getBoundingClientRect();
      this.at = [
        (2 * (event.clientX - box.left)) / box.width - 1,
        1 - (2 * (event.clientY - box.top)) / box.height,
      ];
      this.used = event.pointerType === "touch" ? "touch" : "mouse";
      this.moved = true;
    };
    stage.addEventListener("pointermove", place);
    stage.addEventListener("pointerdown", (event) => {
      place(event);
      this.pressed = event.pointerType !== "touch";
    });
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
      stage.addEventListener(end, () => (this.pressed = false));
    }
    stage.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.wheel = (this.wheel ?? 0) - Math.sign(event.deltaY);
      },
      { passive: false },
    );
  }

  get size() {
    return this.seat === "mouth" ? 5 : 4;
  }

  // Begin from the posture that the person has: a hand's place, or a head's angles.
  begin(now) {
    this.moved = false;
    this.at = null;
    this.held = 1;
    if (this.seat === "mouth") this.head = { lean: now[0], pitch: now[1], yaw: now[2], jaw: now[4] };
    else {
      this.hand = [...now];
      this.home = [...now];
    }
  }

  press(key, down) {
    if (down) {
      this.keys.add(key);
      this.used = "keyboard";
    } else this.keys.delete(key);
  }

  arrows() {
    let [x, y] = [0, 0];
    for (const [key, [dx, dy]] of Object.entries(ARROWS)) {
      if (this.keys.has(key)) [x, y] = [x + dx, y + dy];
    }
    return [x, y];
  }

  // `camera` has `ray(x, y)` and unit vectors `right`, `up` and `away`.
  sample(seconds, camera) {
    return this.seat === "mouth" ? this.sampleHead(seconds) : this.sampleHand(seconds, camera);
  }

  sampleHand(seconds, camera) {
    const add = (vector, share) => {
      for (let i = 0; i < 3; ++i) this.hand[i] += share * vector[i];
    };
    const [x, y] = this.arrows();
    add(camera.right, x * KEY_SPEED * seconds);
    add(camera.up, y * KEY_SPEED * seconds);
    if (this.moved && this.at) {
      // Where the ray meets the plane through the hand that faces the camera.
      const { from, way } = camera.ray(...this.at);
      const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
      const off = this.hand.map((one, i) => one - from[i]);
      const far = dot(off, camera.away) / dot(way, camera.away);
      this.hand = from.map((one, i) => one + far * way[i]);
    }
    this.moved = false;
    const deeper = this.keys.has("PageUp") - this.keys.has("PageDown") + (this.slide ?? 0);
    add(camera.away, deeper * KEY_SPEED * seconds + 0.02 * (this.wheel ?? 0));
    this.wheel = 0;
    const off = this.hand.map((one, i) => one - this.home[i]);
    const length = Math.hypot(...off);
    if (length > REACH) this.hand = this.home.map((one, i) => one + (REACH / length) * off[i]);
    return [...this.hand, this.held];
  }

  sampleHead(seconds) {
    const { head } = this;
    const within = (value, most, least = -most) => Math.max(least, Math.min(most, value));
    const [x, y] = this.arrows();
    if (this.moved && this.at) {
      head.yaw = this.side * HEAD.yaw * this.at[0];
      head.pitch = -HEAD.pitch * this.at[1];
    }
    this.moved = false;
    head.yaw = within(head.yaw + this.side * x * TURN_SPEED * seconds, HEAD.yaw);
    head.pitch = within(head.pitch - y * TURN_SPEED * seconds, HEAD.pitch);
    const leans = this.keys.has("PageUp") - this.keys.has("PageDown") + (this.slide ?? 0) + (this.wheel ?? 0);
    head.lean = within(head.lean + leans * 0.4 * seconds, HEAD.lean);
    this.wheel = 0;
    const opens = this.pressed || this.keys.has(" ") || this.keys.has("m");
    head.jaw = opens ? HEAD.jaw : (this.jaw ?? 0) * HEAD.jaw;
    return [head.lean, head.pitch, head.yaw, 0, head.jaw];
  }
}
