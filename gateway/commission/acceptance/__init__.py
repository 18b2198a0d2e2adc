"""The site acceptance report: its data, its page, its paper, and the hashes that seal them."""

from gateway.commission.acceptance.data import gather
from gateway.commission.acceptance.files import verify, write
