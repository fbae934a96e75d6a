"""The tables. `migrations/versions` brings a database to them; a test holds the two equal.

Times are seconds since 1970 by the server's clock. Identifiers are random words, so that none tells
how many there are, and none of them is a person's.
"""

import sqlalchemy as sa

METADATA = sa.MetaData(
    naming_convention={
        "ix": "ix_%(column_0_label)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _id() -> sa.Column:
    return sa.Column("id", sa.String(32), primary_key=True)


# A lab or a person who submits. Erasing the name and the contact leaves a pseudonym.
submitters = sa.Table(
    "submitters",
    METADATA,
    _id(),
    sa.Column("name", sa.String(80), nullable=False, unique=True),
    sa.Column("contact", sa.String(200)),
    sa.Column("created_at", sa.Float, nullable=False),
    sa.Column("erased_at", sa.Float),
)

# A token's secret is never stored, only its sha256: with 256 random bits it needs no slow hash.
tokens = sa.Table(
    "tokens",
    METADATA,
    _id(),
    sa.Column("sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("scopes", sa.JSON, nullable=False),
    sa.Column("submitter", sa.ForeignKey("submitters.id")),
    sa.Column("label", sa.String(80), nullable=False),
    sa.Column("created_at", sa.Float, nullable=False),
    sa.Column("revoked_at", sa.Float),
)

artefacts = sa.Table(
    "artefacts",
    METADATA,
    sa.Column("sha256", sa.String(64), primary_key=True),
    sa.Column("bytes", sa.Integer, nullable=False),
    sa.Column("created_at", sa.Float, nullable=False),
    sa.Column("erased_at", sa.Float),  # the bytes are gone, the hash stays for the ledger
)

# A private release with two hidden panels. `secret`: its salts, seeds and panels until it closes.
seasons = sa.Table(
    "seasons",
    METADATA,
    _id(),
    sa.Column("name", sa.String(80), nullable=False, unique=True),
    sa.Column("task", sa.String(40), nullable=False),
    sa.Column("state", sa.String(10), nullable=False),
    sa.Column("budget", sa.Integer, nullable=False),  # attempts of each submitter
    sa.Column("rules", sa.Text, nullable=False),
    sa.Column("root", sa.String(64)),  # Merkle root, published when it opens
    sa.Column("release", sa.String(64)),  # sha256 of the packed private release
    sa.Column("secret", sa.JSON, nullable=False),
    sa.Column("panel_sizes", sa.JSON, nullable=False),
    sa.Column("created_at", sa.Float, nullable=False),
    sa.Column("opened_at", sa.Float),
    sa.Column("closes_at", sa.Float),  # announced; then it closes by itself
    sa.Column("closed_at", sa.Float),
    sa.Column("hidden", sa.JSON),  # how many partners of which kind: see `played`
)

# A declared entry: its files are named by their hashes before any of them is scored.
entries = sa.Table(
    "entries",
    METADATA,
    _id(),
    sa.Column("submitter", sa.ForeignKey("submitters.id"), nullable=False),
    sa.Column("request", sa.String(64), nullable=False),  # as of a submission
    sa.Column("task", sa.String(40), nullable=False),
    sa.Column("method", sa.String(80), nullable=False),
    sa.Column("season", sa.ForeignKey("seasons.id")),
    sa.Column("files", sa.JSON, nullable=False),  # sha256 of each seed's file, sorted
    sa.Column("card", sa.JSON, nullable=False),  # what the lab says of it, see `rules.entries`
    sa.Column("created_at", sa.Float, nullable=False),
    sa.Column("frozen_at", sa.Float),  # when all of its files were there; then they are played
    sa.UniqueConstraint("submitter", "request"),
)

submissions = sa.Table(
    "submissions",
    METADATA,
    _id(),
    sa.Column("submitter", sa.ForeignKey("submitters.id"), nullable=False),
    # Chosen by the client, so that a request that is sent again makes no second submission.
    sa.Column("request", sa.String(64), nullable=False),
    sa.Column("task", sa.String(40), nullable=False),
    sa.Column("method", sa.String(80), nullable=False),  # its submissions are seeds of one method
    sa.Column("kind", sa.String(10), nullable=False),
    sa.Column("artefact", sa.ForeignKey("artefacts.sha256")),  # none of a reference
    sa.Column("format", sa.String(20)),
    sa.Column("licence", sa.String(40), nullable=False),
    sa.Column("season", sa.ForeignKey("seasons.id")),
    sa.Column("state", sa.String(10), nullable=False),
    sa.Column("reason", sa.String(40)),  # a word of the vocabulary
    sa.Column("attempt", sa.String(10), nullable=False),
    sa.Column("turn", sa.Integer, nullable=False),  # unfinished ones of this submitter before it
    sa.Column("created_at", sa.Float, nullable=False),
    sa.Column("finished_at", sa.Float),
    sa.Column("entered_at", sa.Float),  # when it was chosen for panel B
    *(sa.Column(name, sa.Text) for name in ("about", "link", "citation")),  # of its method
    sa.Column("warning", sa.Text),  # of another environment version
    sa.Column("entry", sa.ForeignKey("entries.id")),  # that it is a seed of; none: a single robot
    sa.UniqueConstraint("submitter", "request"),
)
sa.Index("ix_submissions_state", submissions.c.state)

# What produced a score: evaluator, environment and engine. Scores of two versions are never mixed.
versions = sa.Table(
    "versions",
    METADATA,
    sa.Column("id", sa.String(64), primary_key=True),  # sha256 of `identity`
    sa.Column("task", sa.String(40), nullable=False),
    sa.Column("identity", sa.JSON, nullable=False),
    sa.Column("created_at", sa.Float, nullable=False),
)

# One chunk of a panel for one submission. A lease ends when it is given back or expires.
jobs = sa.Table(
    "jobs",
    METADATA,
    _id(),
    sa.Column("submission", sa.ForeignKey("submissions.id"), nullable=False),
    sa.Column("version", sa.ForeignKey("versions.id"), nullable=False),
    sa.Column("panel", sa.String(10), nullable=False),
    sa.Column("chunk", sa.Integer, nullable=False),
    sa.Column("state", sa.String(10), nullable=False),
    sa.Column("failures", sa.Integer, nullable=False),
    sa.Column("turn", sa.Integer, nullable=False),
    sa.Column("created_at", sa.Float, nullable=False),
    sa.Column("lease", sa.String(64)),  # sha256 of the lease's secret
    sa.Column("worker", sa.String(80)),
    sa.Column("leased_at", sa.Float),
    sa.Column("expires_at", sa.Float),
    sa.Column("done_at", sa.Float),
    sa.UniqueConstraint("submission", "version", "panel", "chunk"),
)
sa.Index("ix_jobs_state_turn", jobs.c.state, jobs.c.turn, jobs.c.created_at)

# Accepted once for each (submission, version, panel, chunk): a job that was done twice counts once.
results = sa.Table(
    "results",
    METADATA,
    sa.Column("submission", sa.ForeignKey("submissions.id"), primary_key=True),
    sa.Column("version", sa.ForeignKey("versions.id"), primary_key=True),
    sa.Column("panel", sa.String(10), primary_key=True),
    sa.Column("chunk", sa.Integer, primary_key=True),
    sa.Column("table", sa.ForeignKey("artefacts.sha256"), nullable=False),
    sa.Column("seconds", sa.Float, nullable=False),
    sa.Column("created_at", sa.Float, nullable=False),
)

# One row a panel. Of panels A and B only `released` leaves the server, see `ladder`.
scores = sa.Table(
    "scores",
    METADATA,
    sa.Column("submission", sa.ForeignKey("submissions.id"), primary_key=True),
    sa.Column("version", sa.ForeignKey("versions.id"), primary_key=True),
    sa.Column("panel", sa.String(10), primary_key=True),
    sa.Column("figures", sa.JSON, nullable=False),
    sa.Column("released", sa.JSON(none_as_null=True)),  # what may be shown; null: nothing
    sa.Column("created_at", sa.Float, nullable=False),
)

# Public half only: the returns of every episode with every partner.
partner_scores = sa.Table(
    "partner_scores",
    METADATA,
    sa.Column("submission", sa.ForeignKey("submissions.id"), primary_key=True),
    sa.Column("version", sa.ForeignKey("versions.id"), primary_key=True),
    sa.Column("partner", sa.String(120), primary_key=True),
    sa.Column("algorithm", sa.String(40), nullable=False),
    sa.Column("disability", sa.String(10), nullable=False),
    sa.Column("returns", sa.JSON, nullable=False),  # [K]
    sa.Column("successes", sa.Integer, nullable=False),
)

# Append-only: `hash` covers the entry and the hash of the one before.
ledger = sa.Table(
    "ledger",
    METADATA,
    sa.Column("seq", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("at", sa.Float, nullable=False),
    sa.Column("kind", sa.String(40), nullable=False),
    sa.Column("body", sa.JSON, nullable=False),
    sa.Column("previous", sa.String(64), nullable=False),
    sa.Column("hash", sa.String(64), nullable=False, unique=True),
)

receipts = sa.Table(
    "receipts",
    METADATA,
    sa.Column("submission", sa.ForeignKey("submissions.id"), primary_key=True),
    sa.Column("version", sa.ForeignKey("versions.id"), primary_key=True),
    sa.Column("content", sa.JSON, nullable=False),
    sa.Column("signature", sa.String(128), nullable=False),
    sa.Column("created_at", sa.Float, nullable=False),
)

# What the organiser is to know: one row for each thing, however often it happened.
notices = sa.Table(
    "notices",
    METADATA,
    sa.Column("kind", sa.String(40), primary_key=True),  # a word of `notices.KINDS`
    sa.Column("about", sa.String(200), primary_key=True),  # such as a submission's id
    sa.Column("count", sa.Integer, nullable=False),
    sa.Column("first_at", sa.Float, nullable=False),
    sa.Column("last_at", sa.Float, nullable=False),
)

# Columns, for queries: `JOB.state == "waiting"`.
SUBMITTER, TOKEN, ARTEFACT, SEASON = submitters.c, tokens.c, artefacts.c, seasons.c
SUBMISSION, VERSION, JOB, RESULT = submissions.c, versions.c, jobs.c, results.c
SCORE, PARTNER_SCORE, ENTRY, RECEIPT = scores.c, partner_scores.c, ledger.c, receipts.c
NOTICE, DECLARED = notices.c, entries.c

ERASED = sa.select(ARTEFACT.sha256).where(ARTEFACT.erased_at.is_not(None))  # files that are gone
# Declared entries that lack files: nothing of them is played yet.
UNFROZEN = sa.select(DECLARED.id).where(DECLARED.frozen_at.is_(None))
MAX_FAILURES = 5  # of a job: then it is given up, as is its submission, whose attempt is refunded
