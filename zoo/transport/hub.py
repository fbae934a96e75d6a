"""A hub's model repository as a remote, and its client's errors as errors of the zoo."""

import contextlib
import re
from collections.abc import Generator
from typing import NoReturn

from huggingface_hub import HfApi, constants, errors, hf_hub_url
from huggingface_hub.utils import build_hf_headers

from assistax_base.errors import MissingRepositoryError, RemoteError, listing, nearest, shorten
from zoo.transport.remotes import HttpRemote, network_errors, refuse_status, with_retries


class HubRemote(HttpRemote):
    """A model repository on a hub, read from the one commit that its revision first named."""

    def __init__(self, name: str, repo: str, ref: str) -> None:
        super().__init__(name)
        _check_endpoint()
        self.repo, self.ref = repo, ref
        self._commit: str | None = None

    @property
    def revision(self) -> str:
        """The commit that the user's revision names; the hub is asked once."""
        if self._commit is None:
            self._commit = with_retries(self._resolve, self.name)
        return self._commit

    def url(self, path: str) -> str:
        """Return the address of a file at the commit."""
        return hf_hub_url(self.repo, path, revision=self.revision, endpoint=constants.ENDPOINT)

    def headers(self) -> dict[str, str]:
        """Return the hub's headers: the user's token, if any, and the client's name."""
        return build_hf_headers(library_name="assistax-zoo")

    def _resolve(self) -> str:
        with hub_errors(self):
            info = HfApi(endpoint=constants.ENDPOINT).model_info(
                self.repo, revision=self.ref, timeout=_timeout()
            )
            if not info.sha:
                raise RemoteError(
                    self.name, "a repository with a commit", "an empty one", "publish to it first"
                )
            return info.sha


@contextlib.contextmanager
def hub_errors(remote: HubRemote) -> Generator[None]:
    """Raise `RemoteError` or `TransientError` in place of the errors of the hub's client."""
    try:
        with network_errors(remote):
            yield
    except errors.RevisionNotFoundError:
        _refuse_revision(remote)
    except errors.GatedRepoError:
        raise RemoteError(
            remote.name,
            "a repository that you may read",
            "a gated one",
            "ask for access, and run `hf auth login`",
        ) from None
    except errors.RepositoryNotFoundError:
        _refuse_repository(remote)
    except errors.HfHubHTTPError as error:
        refuse_status(error.response, remote.name)


def _check_endpoint() -> None:
    if not re.match(r"https?://[^/]", constants.ENDPOINT):
        raise RemoteError(
            "HF_ENDPOINT, the address of the hub",
            "https:// or http:// and a host, as in https://hub.example",
            shorten(constants.ENDPOINT),
            "set HF_ENDPOINT so, or unset it",
        )


def _refuse_revision(remote: HubRemote) -> NoReturn:
    with network_errors(remote):
        refs = HfApi(endpoint=constants.ENDPOINT).list_repo_refs(remote.repo)
    known = [ref.name for ref in (*refs.branches, *refs.tags)]
    close = nearest(remote.ref, known) or known
    raise RemoteError(
        remote.name,
        f"a branch, tag or commit ({listing(close)})",
        f"no revision {remote.ref!r}",
        "use one of these",
    )


def _refuse_repository(remote: HubRemote) -> NoReturn:
    for kind in ("dataset", "space"):
        with contextlib.suppress(errors.HfHubHTTPError), network_errors(remote):
            HfApi(endpoint=constants.ENDPOINT).repo_info(
                remote.repo, repo_type=kind, timeout=_timeout()
            )
            raise RemoteError(
                remote.name,
                "a model repository",
                f"a {kind}",
                "publish the zoo in a model repository",
            )
    expected = "a model repository that you may read"
    raise MissingRepositoryError(remote.name, expected, "no such repository")


def _timeout() -> float:
    return constants.HF_HUB_DOWNLOAD_TIMEOUT
