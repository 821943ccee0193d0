"""The two real tables, joined by a bus that is the attacker, explored breadth first.

The bus. Whatever carries no code anybody on the bus can write: session tag, nonces and epoch can be read, a check
value is no secret. So every such record and frame, with every content the tables tell apart, and everything that is
signed, under a code that does not fit, may arrive at either side at any moment (``attacker``). Whatever carries a code
that fits can only have been made by a side; once made it may arrive at any moment, any number of times, in any order,
or never. That is more than loss, duplication, reordering, delay, corruption (the codes refuse it; the third in a
second is a fault of its own) and replay can do, with any number of records under way and everything earlier in the
attacker's hands.

What has been said only grows until what it names has passed away, and with more said everything can happen that can
with less. So of a controller's and runtime's states those with less said need not be visited again (``search``).

Heartbeats. Of the runtime's, one that says CUT in the present epoch comes only once it was said in this session, and
is fresh only until a time-out has passed since the runtime last said it: that passing is a move (``Model.ages``),
after which a controller that moved has lost the heartbeat, or has heard what the runtime says now, which is a move of
its own. All others are taken as said in every session, fresh and stale: they order no motion. Of the controller's,
that it is permitted, cuts or is done comes to a runtime that believes it only once it was said in the runtime's
session, with any inputs, fresh or stale, then for good. OPENED of the present epoch comes once the controller has
opened the runtime's session and has not stopped since, with everything that it can say of its memory. A controller has
one epoch in a session until a stop, and goes only forward in it, so that what was said earlier is all that could be
held back. Order and counter are left out: more can happen. What a link refuses (a wrong tag, another session's,
another counter's) stops its side, which the shell's faults do as well.

Announce nonces. The one that the runtime's OPEN names, every earlier one, and the next one, once an OPEN has used it
up. What is signed and can only withdraw, or stop, is taken as said; so are OPENs of earlier runtimes that were held
back.

Times of registrations are compared with the barrier alone. A Withdraw tells one that is later than all that was known,
or, where the bone moved before, one before its own registration; either, said earlier in the session, may come after a
motion in it.

Names. Both tables compare epochs, nonces, sessions, places and registrations for equality only, and only the
controller makes new ones. Each is the present one or an earlier one; when the present one passes away, everything else
that names it is renamed (``names``). All earlier ones are one: as nothing new is ever equal to them, only two earlier
ones could be told apart, and what names two of them is refused with one. The epoch has five bits: 32 stops between two
looks are left out. Of registrations the present and one other are told apart, and a new one may come at any time.

Records that serve no more. A permit, start or reset of the present session that differs from one that serves in
nothing but its nonce, its epoch, what its nonce was given for, its session or announce nonce is taken as said already,
code included; every rule is a comparison, so that one which differs in more is accepted in no more cases. A reset
serves only while its cause is latched: a latch, and another cause of it, come with a new epoch. A runtime with an
earlier epoch or boot can make only such, so that it does not matter which it has (``Model.settled``).

Past. A runtime that is stopping, or whose session has an earlier epoch or boot, stays so (``names.is_past``). It signs
only such records, and whatever else it says is taken as said: stops, withdrawals, heartbeats that order no motion. To
the controller it is as if its process had died, which may happen at any moment; so in the world it has died. It is led
on by itself, whatever a controller may ever say to it, with the runtime's invariants (``alone``). What remains is
either not yet in a session or in the live one of the controller, and the controllers without one, in another or in a
voided one meet few runtimes.

Taken as so. Of two controllers the one that can do more stands for both (``canonical.taken_controller``). The last
heartbeat was fresh: one that is may have come at any moment, what is refused because it was stale is refused for other
reasons as well, and where the arm moves it was fresh. The device is released until the permit, which then also comes
to one that is pressed: nothing before it looks at the device. The cause that stands is acknowledged at any moment: the
operator's Acknowledge is taken as said.

``World.exact`` does without these four, for traces in which only what was said is repeated. ``test_canonical.py``
compares: where a controller leads, that which is taken for it must lead too, and every state that the exact world
comes to within a number of moves must be met in the other one.

Time. No clock runs: that something is too old when it is looked at is chosen anew at each look, a deadline or time-out
may pass at any moment, and so is where the arm stands. What ages were remembered is forgotten (``canonical``), and so
is what the tracking monitor has seen of a moving arm: it is the real one, always just begun, and joints and progress
come that fit and that break each of its rules which a single frame can break.

Causes that stand, at the controller, latched or not, and as the runtime last heard of them, are only named again; but
an emergency stop must be clear to be acknowledged. So there are two, and none. As one comes, four classes are told
apart.

Disk and memory. A record becomes durable in time, late or never. The log that the controller saw last, of which it
tells in OPENED, is being looked up, found, as if there were none, or not found. The controller writes its memory
within the step that asks for it, as its program does, or cannot; power is lost between steps, which is before the
write as well.

Invariant 5 needs no attacker, and nothing that is taken as said or as so: from every runtime the operator's stop leads
to the end of its process, whatever arrives meanwhile (a stopping one can do nothing else); without a process, and with
everything delivered at once and in order, every controller that was met gets back to motion (``recovery``). What was
still under way when the attacker fell silent leads to another state that was met.
"""
