"use strict";
// A study: robots are played blind, in blocks. A block has each robot once, in an order by chance,
// with one start and one wish.

function shuffled(count) {
  const order = Array.from({ length: count }, (_, i) => i);
  for (let i = count - 1; i > 0; --i) {
    const j = crypto.getRandomValues(new Uint32Array(1))[0] % (i + 1);
    [order[i], order[j]] = [order[j], order[i]];
  }
  return order;
}

const letterOf = (place) => `robot ${String.fromCharCode(65 + place)}`;

class Study {
  constructor(robots) {
    this.robots = robots;
    this.byLetter = shuffled(robots.length); // the robot that each letter stands for in this page
    this.block = 0;
    this.next();
  }

  // Begin another block.
  next() {
    this.block += 1;
    this.order = shuffled(this.robots.length);
    this.turn = 0;
  }

  get robot() {
    return this.order[this.turn];
  }

  get letter() {
    return letterOf(this.byLetter.indexOf(this.robot));
  }

  // Count an episode as played; return whether the block is done.
  played() {
    this.turn += 1;
    if (this.turn < this.robots.length) return false;
    this.next();
    return true;
  }

  // What the log says of it.
  about() {
    return { blind: true, block: this.block, order: this.order.map((i) => this.robots[i].name) };
  }
}
