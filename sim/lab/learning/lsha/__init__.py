"""Method `lsha`: L*_SHA, a learner with an observation table and a teacher who answers from traces."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.learning.lsha.hypothesis import ObservationTable, TableRow, TraceAcceptance
    from sim.lab.learning.lsha.learn import LearnedLsha, learn_lsha
    from sim.lab.learning.lsha.report import report_document, report_text
    from sim.lab.learning.lsha.settings import FLOW_KINDS, LshaSettings
else:
    __getattr__ = lazy_getattr(__name__)
